"""How well a position explains what an array has received: spectra to look up in, and the exact filter."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from chachart.node.estimation.fusion.site import OVERSAMPLING, Complex, Floats, Site, phasor

Singles = NDArray[np.float32]


class Received:
    """The frames of one array, one a UE.

    Parameters
    ----------
    site
        The array.
    csi
        complex64 (U, N, S); a UE that the array has not received has zeros.

    Attributes
    ----------
    energy
        sum |h|^2 (U,), what a position can explain at most.
    """

    def __init__(self, site: Site, csi: Complex) -> None:
        self.site = site
        self._csi = csi
        flat = csi.reshape(len(csi), -1).view(np.float32)
        self.energy: Singles = np.einsum("ui,ui->u", flat, flat)
        self._delays = OVERSAMPLING * csi.shape[2]

    def responses(self) -> Complex:
        """Delay responses (U, N, L) of the elements, L = 4 S, delays counted from the middle of the band."""
        tones = self._csi.shape[2]
        found = scipy.fft.ifft(self._csi, self._delays, axis=2, norm="forward")
        found *= phasor(-(tones - 1) / 2 * np.arange(self._delays) / self._delays)
        found *= np.float32(1 / np.sqrt(self.site.samples))
        return np.asarray(found, np.complex64)

    def spectrum(self, beams: Complex) -> Singles:
        """|a^H h|^2 / |a|^2 (U, D, L) of plane waves: directions `beams` (D, N), all delays."""
        z = beams @ self.responses()
        return z.real**2 + z.imag**2

    def power(self, points: Floats, delay_m: Floats | None = None) -> Singles:
        """|a^H h|^2 / |a|^2 (U, Q) of spherical waves from `points` (U, Q, 3): the exact matched filter.

        `delay_m` (U, Q) is what the clocks add to every distance. Zero for points behind the array.
        """
        rho, front = self.site.ranges(points)
        far = rho if delay_m is None else rho + delay_m
        beamed = self.site.match(points, rho) @ self._csi
        found = np.einsum("uqs,uqs->uq", self._tones(far), beamed)
        scale = np.float32(1 / self.site.samples)
        return np.where(front, (found.real**2 + found.imag**2) * scale, np.float32(0))

    def best_power(self, points: Floats) -> Singles:
        """The largest of `power` (U, Q) over all delays, for clocks that know nothing of each other."""
        rho, front = self.site.ranges(points)
        beamed = self.site.match(points, rho) @ self._csi
        z = scipy.fft.ifft(beamed, self._delays, axis=2, norm="forward")
        found = (z.real**2 + z.imag**2).max(axis=2) * np.float32(1 / self.site.samples)
        return np.where(front, found, np.float32(0))

    def _tones(self, far: Floats) -> Complex:
        """Conjugate phases (U, Q, S) of the tones at distances (U, Q): two short rows of them multiplied."""
        count = self._csi.shape[2]
        cycles = (far / self.site.unambiguous_m)[..., None]
        short = int(np.ceil(np.sqrt(count)))
        fine = phasor(cycles * np.arange(short))
        coarse = phasor(cycles * (short * np.arange(-(-count // short))))
        product = coarse[..., None] * fine[..., None, :]
        return product.reshape(*far.shape, -1)[..., :count]
