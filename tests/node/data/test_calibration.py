from dataclasses import replace

import numpy as np
import pytest
from csi_samples import small_array
from hypothesis import given
from hypothesis import strategies as st

from chachart.config.settings import ArraySettings
from chachart.node.data.calibration import Calibration
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.calibration import load_calibration, save_calibration


def some_calibration(antennas: int = 4, subcarriers: int = 3) -> Calibration:
    rng = np.random.default_rng(4)
    antenna = rng.uniform(0.5, 2, antennas) * np.exp(2j * np.pi * rng.random(antennas))
    subcarrier = rng.uniform(0.5, 2, subcarriers) * np.exp(2j * np.pi * rng.random(subcarriers))
    return Calibration.of(rng.permutation(antennas), antenna, subcarrier)


def spoiled(calibration: Calibration, true: np.ndarray) -> np.ndarray:
    """What an array with that calibration measures of true channels."""
    c = calibration
    antenna = np.array(c.antenna_gain) * np.exp(1j * np.array(c.antenna_phase_rad))
    subcarrier = np.array(c.subcarrier_gain) * np.exp(1j * np.array(c.subcarrier_phase_rad))
    measured = np.empty_like(true)
    measured[:, list(c.antenna_order)] = true * antenna[:, None] * subcarrier
    return measured


def test_applying_it_gives_the_true_channels_back():
    rng = np.random.default_rng(5)
    true = (rng.standard_normal((7, 4, 3)) + 1j * rng.standard_normal((7, 4, 3))).astype(np.complex64)
    calibration = some_calibration()
    corrected = calibration.apply(spoiled(calibration, true))
    assert corrected.dtype == np.complex64
    np.testing.assert_allclose(corrected, true, rtol=1e-5)


def test_an_order_alone_changes_nothing_else():
    true = np.arange(12, dtype=np.complex64).reshape(1, 4, 3)
    calibration = Calibration.order_only((2, 0, 1, 3), 3)
    np.testing.assert_array_equal(calibration.apply(true)[0, :, 0], true[0, [2, 0, 1, 3], 0])


def test_it_survives_a_file(tmp_path):
    calibration = some_calibration()
    save_calibration(tmp_path / "cal.toml", calibration, 'from "somewhere"')
    back = load_calibration(tmp_path / "cal.toml")
    assert back.antenna_order == calibration.antenna_order
    for name in ("antenna_gain", "antenna_phase_rad", "subcarrier_gain", "subcarrier_phase_rad"):
        np.testing.assert_allclose(getattr(back, name), getattr(calibration, name), atol=2e-6)


def test_it_travels_with_its_array():
    array = ArrayGeometry("lab", 4, 3, 2e9, 312_500.0, 0.075, calibration=some_calibration())
    assert ArrayGeometry.from_dict(array.as_dict()) == array
    assert array.mismatches(replace(array, calibration=None)) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"antenna_order": (0, 1, 2, 2)}, "antenna_order must hold each of 0 to 3 once"),
        ({"antenna_gain": (1.0, 1.0)}, "antenna_gain must have 4 values, not 2"),
        ({"antenna_gain": (1.0, 1.0, 0.0, 1.0)}, "antenna_gain must be positive numbers"),
        ({"subcarrier_phase_rad": (0.0, float("nan"), 0.0)}, "subcarrier_phase_rad must be finite numbers"),
    ],
)
def test_nonsense_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        replace(some_calibration(), **changes)


def test_it_must_fit_the_array():
    with pytest.raises(ValueError, match="the calibration is of 9 antennas and 3 subcarriers"):
        replace(small_array(), calibration=some_calibration(9))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read"),
        ("[antenna", "is no calibration"),
        ("version = 1", "is no calibration: antenna: Field required"),
        ("version = 2", "version"),
        (
            "version = 1\n[antenna]\norder = [0, 0]\ngain_db = [0, 0]\nphase_deg = [0, 0]\n"
            "[subcarrier]\ngain_db = [0]\nphase_deg = [0]\n",
            "each of 0 to 1 once",
        ),
        (
            "version = 1\n[antenna]\norder = [0]\ngain_db = [1e9]\nphase_deg = [0]\n"
            "[subcarrier]\ngain_db = [0]\nphase_deg = [0]\n",
            "is no calibration",
        ),
    ],
)
def test_a_file_that_holds_none_is_said_so(tmp_path, content, said):
    path = tmp_path / "cal.toml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ValueError, match=said):
        load_calibration(path)


def test_settings_give_the_correction(tmp_path):
    save_calibration(tmp_path / "cal.toml", some_calibration(), "")
    assert ArraySettings().correction() is None
    assert ArraySettings(antennas=2, antenna_order=(1, 0)).correction() == Calibration.order_only((1, 0), 32)
    assert ArraySettings(calibration=tmp_path / "cal.toml").correction() is not None
    with pytest.raises(ValueError, match="antenna_order cannot be set beside calibration"):
        ArraySettings(calibration=tmp_path / "cal.toml", antenna_order=(0, 1)).correction()


@given(
    st.sampled_from([*some_calibration().as_dict(), "other"]),
    st.none() | st.integers() | st.text() | st.lists(st.integers() | st.floats() | st.text(), max_size=5),
)
def test_any_description_is_a_calibration_or_a_value_error(name, value):
    try:
        calibration = Calibration.from_dict({**some_calibration().as_dict(), name: value})
    except ValueError:
        return
    assert Calibration.from_dict(calibration.as_dict()) == calibration
