"""The figures by which multipath channels are told apart, and the real simulator's channels."""

import os
from pathlib import Path

import numpy as np
import pytest
import scipy.fft

from chachart.config.settings import ArraySettings

BANDWIDTH_HZ = 10e6


def parabola(power, index):
    """Where between its neighbours a sampled spectrum (U, G), cyclic, peaks: an index with a fraction."""
    row, size = np.arange(len(power)), power.shape[1]
    left, top, right = (power[row, (index + step) % size] for step in (-1, 0, 1))
    return index + 0.5 * (left - right) / (left - 2 * top + right)


def channel_figures(csi, array, position):
    """Per UE: amplitude variation over the antennas, |theta error| of a Bartlett scan (deg), beamspace
    participation ratio, share of the power on the exact direct steering vector, all on the first subcarrier;
    and |rho error| (m) of a Bartlett scan over the subcarriers."""
    offset = position - array.element_positions().mean(axis=0)
    rho = np.linalg.norm(offset, axis=1)
    cosine = offset @ np.array(array.axis) / rho
    first = csi[:, :, 0].astype(complex)
    amplitude = np.abs(first)
    beams = np.abs(scipy.fft.fft(first, axis=1)) ** 2
    steering = np.exp(1j * array.theta_phase * cosine[:, None] * np.arange(array.antennas))
    direct = np.abs(np.sum(steering.conj() * first, axis=1)) ** 2 / array.antennas

    size = 1024
    spectrum = np.abs(scipy.fft.fft(first, size, axis=1)) ** 2
    u = 2 * np.pi * parabola(spectrum, spectrum.argmax(axis=1)) / size
    found = ((u + np.pi) % (2 * np.pi) - np.pi) / array.theta_phase
    theta_error = np.abs(np.arccos(np.clip(found, -1, 1)) - np.arccos(cosine))

    profile = np.zeros((len(csi), size))
    for antenna in range(array.antennas):
        profile += np.abs(scipy.fft.ifft(csi[:, antenna], size, axis=1)) ** 2
    found = parabola(profile, profile.argmax(axis=1)) / size * array.unambiguous_rho_m
    return {
        "amplitude variation": amplitude.std(axis=1) / amplitude.mean(axis=1),
        "theta error": np.rad2deg(theta_error),
        "participation": beams.sum(axis=1) ** 2 / np.sum(beams**2, axis=1),
        "direct power": direct / np.sum(amplitude**2, axis=1),
        "rho error": np.abs(found - rho),
    }


@pytest.fixture(scope="session")
def figures():
    """`channel_figures`."""
    return channel_figures


@pytest.fixture(scope="session")
def wide_array():
    """The reference array at 10 MHz, its middle a quarter wavelength along y as in the real simulator's."""
    half_wavelength = ArraySettings().geometry().element_spacing_m
    return ArraySettings(
        subcarrier_spacing_hz=BANDWIDTH_HZ / 32, position_m=(0.0, -15 * half_wavelength, 10.0)
    ).geometry()


@pytest.fixture(scope="session")
def real_channels():
    """Function: name -> (csi, position) of the real simulator; skips where its channels are not at hand."""
    beside = Path(__file__).parents[4] / "shared" / "data"
    folder = Path(os.environ.get("CHACHART_DATA", beside))

    def load(name):
        path = folder / f"quadriga_{name}_a.npz"
        if not path.exists():
            pytest.skip(f"no reference channels at {path}; CHACHART_DATA tells where they are")
        with np.load(path) as data:
            return data["csi"], data["position"].astype(float)

    return load
