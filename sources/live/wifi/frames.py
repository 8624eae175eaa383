"""From what a tool's records say to frames of the array: which tones, which power, who sent, when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.formats.wifi.log import Group, Log, Tones
from chachart.sources.live.device import Frame

SHORTEST_STEP_NS = 1


class Selection:
    """Frames of one array out of logs, in the order in which they came.

    Parameters
    ----------
    array
        Its antennas, and its tones: those that the tool gives must hold them.
    power
        "rssi" scales frames to the received power, "agc" undoes the receiver's gain, "raw" leaves them;
        "auto" scales those of tools that tell the power.
    rejected
        Where all others are counted by reason.
    """

    def __init__(self, array: ArrayGeometry, power: str, rejected: Counters) -> None:
        self._array, self._power, self._rejected = array, power, rejected
        self._latest_ns = 0

    def frames(self, log: Log, now_ns: int) -> list[Frame]:
        """The frames in a log whose newest frame came at `now_ns`."""
        for reason, count in log.left_out.items():
            self._rejected.add(reason.replace(" ", "_"), count)
        found: list[tuple[int, Frame]] = []
        for group in log.groups:
            found += self._of_group(group, now_ns)
        return [frame for _, frame in sorted(found, key=lambda pair: pair[0])]

    def _of_group(self, group: Group, now_ns: int) -> list[tuple[int, Frame]]:
        if group.kind.antennas != self._array.antennas:
            self._rejected.add("other_antennas", len(group))
            return []
        place = tone_places(group.kind.tones, group.kind.subcarriers, self._array)
        if place is None:
            self._rejected.add("other_subcarriers", len(group))
            return []
        csi = np.ascontiguousarray(group.csi[:, :, 0][:, :, place])
        good = self._scaled(group, csi)
        if not good.all():
            self._rejected.add("no_power", int(np.count_nonzero(~good)))
        times = self._times(group, now_ns)
        ues = group.columns["ue"].tolist()
        return [
            (number, Frame(int(ues[row]), int(times[row]), csi[row]))
            for row, number in enumerate(group.number.tolist())
            if good[row]
        ]

    def _times(self, group: Group, now_ns: int) -> NDArray[np.int64]:
        """Host times: the last one's is now, the others are before it as the device's clock says."""
        device = group.columns.get("time", np.zeros(len(group), np.int64))
        before = np.clip(device.max() - device, 0, max(now_ns - self._latest_ns, 0))
        times: NDArray[np.int64] = now_ns - before.astype(np.int64)
        self._latest_ns = now_ns
        return times

    def _scaled(self, group: Group, csi: NDArray[np.complex64]) -> NDArray[np.bool_]:
        """Scale the frames (F, antennas, tones) in place; which of them say their power."""
        columns = group.columns
        if self._power == "rssi" or (self._power == "auto" and "rssi_dbm" in columns):
            dbm = columns.get("rssi_dbm", np.full(len(group), np.nan)).astype(np.float64)
            mean = np.mean(np.square(np.abs(csi), dtype=np.float64), axis=(1, 2))
            good: NDArray[np.bool_] = np.isfinite(dbm) & (mean > 0)
            factor = np.sqrt(np.divide(10 ** (dbm / 10), mean, out=np.ones(len(mean)), where=good))
        elif self._power == "agc":
            good = np.full(len(group), "agc" in columns)
            none = np.zeros(len(group))
            factor = 10 ** (-(columns.get("agc", none) + 0.25 * columns.get("fft", none)) / 20)
        else:
            return np.ones(len(group), bool)
        csi *= factor[:, None, None].astype(np.float32)
        return good


def tone_places(tones: Tones, count: int, array: ArrayGeometry) -> list[int] | None:
    """Which of a tool's `count` subcarriers are the array's; None where they do not hold them.

    The array says its tones, or how many there are: then all of the tool's, or those that carry a signal.
    """
    numbers = tones.numbers
    if array.tones is not None:
        if numbers is None or not set(array.tones) <= set(numbers):
            return None
        return [numbers.index(tone) for tone in array.tones]
    if count == array.subcarriers:
        return list(range(count))
    carrying = [n for n in tones.used if n not in tones.weak]
    if numbers is None or len(carrying) != array.subcarriers:
        return None
    return [numbers.index(tone) for tone in carrying]
