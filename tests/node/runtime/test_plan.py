from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from csi_samples import small_array, some_block

import chachart.config
from chachart.config.load import load
from chachart.config.settings import ArraySettings
from chachart.node.data.errors import SetupError
from chachart.node.estimation.options import Options
from chachart.node.files.recording import RecordingWriter
from chachart.node.runtime.plan import Plan, check, estimator_problems, resolve_array
from chachart.sources.recording import Recording, RecordingSettings
from chachart.sources.simulator import Simulator, SimulatorSettings

SHIPPED = sorted(Path(str(chachart.config.__file__)).parent.glob("*.toml"))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "capture.mcap"
    with RecordingWriter(path, small_array()) as writer:
        writer.write(some_block())
    return path


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_configurations_make_a_plan(path: Path, capture: Path) -> None:
    replays = load(path).source.type == "recording"
    settings = load(path, [f"source.path={capture}"] if replays else [])
    plan = Plan.of(settings)
    assert plan.misfits() == []


def test_the_source_may_carry_the_array(capture: Path) -> None:
    assert resolve_array(None, Recording, RecordingSettings(path=capture)) == small_array()


def test_an_array_that_agrees_keeps_its_own_name(capture: Path) -> None:
    array = small_array()
    own = ArraySettings(
        name="roof",
        antennas=array.antennas,
        subcarriers=array.subcarriers,
        subcarrier_spacing_hz=array.subcarrier_spacing_hz,
        element_spacing_m=array.element_spacing_m,
        position_m=array.position_m,
        axis=array.axis,
        broadside=array.broadside,
    )
    assert resolve_array(own, Recording, RecordingSettings(path=capture)).name == "roof"


def test_a_recording_of_half_the_carriers_wavelength_fits_a_default_array(tmp_path: Path) -> None:
    own = ArraySettings(antennas=4, subcarriers=3, subcarrier_spacing_hz=1e6)
    older = replace(own.geometry(), element_spacing_m=own.geometry().wavelength_m / 2)
    path = tmp_path / "older.mcap"
    with RecordingWriter(path, older) as writer:
        writer.write(some_block())
    assert resolve_array(own, Recording, RecordingSettings(path=path)) == older
    wider = ArraySettings(antennas=4, subcarriers=3, subcarrier_spacing_hz=1e6, element_spacing_m=0.08)
    with pytest.raises(SetupError, match="element_spacing_m"):
        resolve_array(wider, Recording, RecordingSettings(path=path))


def test_every_difference_is_told(capture: Path) -> None:
    own = ArraySettings(antennas=8, subcarriers=5)
    with pytest.raises(SetupError, match=r"antennas: 8 against 4; subcarriers: 5 against 3"):
        resolve_array(own, Recording, RecordingSettings(path=capture))


def test_no_array_at_all() -> None:
    with pytest.raises(SetupError, match=r"\[array\] is missing: source \"simulator\""):
        resolve_array(None, Simulator, SimulatorSettings())


def test_axes_that_do_not_fit() -> None:
    own = ArraySettings(axis="y", broadside="y")
    with pytest.raises(SetupError, match="orthogonal"):
        resolve_array(own, Simulator, SimulatorSettings())


def test_all_mistakes_are_found_at_once(tmp_path: Path) -> None:
    config = tmp_path / "bad.toml"
    config.write_text(
        '[source]\ntype = "recording"\npath = "nowhere.mcap"\n'
        '[[sinks]]\ntype = "publisher"\nendpoint = "tcp://192.0.2.1:5556"\n'
    )
    mistakes = check(load(config))
    assert len(mistakes) == 3
    assert "nowhere.mcap" in mistakes[0]
    assert "set keys in [security]" in mistakes[1]
    assert "cannot listen on tcp://192.0.2.1:5556" in mistakes[2]


def test_workers_share_the_ues(tmp_path: Path) -> None:
    config = tmp_path / "many.toml"
    config.write_text(
        '[array]\n[source]\ntype = "simulator"\n[workers]\ncount = 4\n'
        "[estimator]\nmax_ues = 10000\nlr_train_ues = 10\n"
    )
    plan = Plan.of(load(config))
    share = plan.worker_estimator()
    assert 2500 < share["max_ues"] < 3000
    assert share["lr_train_ues"] == 3
    assert plan.block_frames == 64


def test_a_block_never_has_more_ues_than_a_worker_may_hold(tmp_path: Path) -> None:
    config = tmp_path / "few.toml"
    config.write_text('[array]\n[source]\ntype = "simulator"\n[estimator]\nmax_ues = 5\n')
    assert Plan.of(load(config)).block_frames == 5


def test_estimators_that_cannot_be_made() -> None:
    [problem] = estimator_problems(small_array(), Options(theta="music", signal_order=9))
    assert "signal_order" in problem


def test_two_sinks_on_one_endpoint_are_a_mistake(tmp_path: Path) -> None:
    config = tmp_path / "node.toml"
    sink = f'[[sinks]]\ntype = "publisher"\nendpoint = "ipc://{tmp_path}/chart"\n'
    free = '[[sinks]]\ntype = "view"\nport = 0\n[[sinks]]\ntype = "metrics"\nport = 0\n'
    config.write_text(f'[array]\n[source]\ntype = "simulator"\n{sink}{free}')
    assert check(load(config)) == []
    config.write_text(f'[array]\n[source]\ntype = "simulator"\n{sink}{sink}')
    assert check(load(config)) == [
        f'"publisher" and "publisher" cannot both listen on ipc://{tmp_path}/chart'
    ]


def test_more_ues_than_memory_holds_are_refused_with_what_fits() -> None:
    array = replace(small_array(), antennas=256, subcarriers=64)
    [problem] = estimator_problems(array, Options(theta="music", rho="music", max_ues=10**9))
    assert re.search(
        r"max_ues = 1000000000 takes \d+\.\d GiB of memory \(5\d\d KiB a UE: music and music of", problem
    )
    most = int(problem.rpartition(" ")[2])
    assert estimator_problems(array, Options(theta="music", rho="music", max_ues=most)) == []
    assert estimator_problems(array, Options(theta="music", rho="music", max_ues=most + 1)) != []


def test_blocks_fit_into_a_message() -> None:
    def planned(antennas: int, subcarriers: int) -> Plan:
        settings = load(None, [f"array.antennas={antennas}", f"array.subcarriers={subcarriers}"])
        return Plan.of(settings)

    assert planned(32, 32).block_frames == 64
    large = planned(1024, 4096)
    assert large.block_frames * 8 * 1024 * 4096 <= 256 * 2**20
    assert not any("a frame of" in problem for problem in estimator_problems(large.array, large.estimator))
    larger = replace(large.array, subcarriers=2**16)
    [problem] = [p for p in estimator_problems(larger, large.estimator) if "a frame of" in p]
    assert "1024 antennas x 65536 subcarriers is larger than 256 MiB" in problem
