"""A Wi-Fi capture as the importer sees it: its log, and the variables of one kind of frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture, Variable
from chachart.sources.formats.wifi.log import Group, Log, Tones

Read = Callable[[NDArray[np.uint8]], Log]


class WifiCapture(Capture):
    """A capture that was decoded whole when it was opened.

    Variables are those of the commonest kind of frames: `csi` for the first stream, `csi_1` ... for the
    others, and the columns of its group.

    Attributes
    ----------
    log
        Everything in the file.
    group
        The kind of frames that the variables are of; `choose` takes another one.

    Raises
    ------
    SetupError
        If the file cannot be read or has no frame that is whole.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        read: Read,
        axes: tuple[str, ...] = ("ue", "subcarrier", "antenna"),
        other_ways: Mapping[str, Read] | None = None,
    ) -> None:
        self.format, self.axes = name, axes
        self._other_ways = other_ways or {}
        self._logs: dict[str, Log] = {}
        try:
            self._data = np.fromfile(path, np.uint8)
            self.log = read(self._data)
            self.group = self.log.commonest()
        except OSError as error:
            raise SetupError(f"{path} cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise SetupError(f"{path}, {name}: {error}") from None
        super().__init__(path, {})
        self.choose(self.group)

    def choose(self, group: Group) -> None:
        """Take the variables from this group of the log."""
        self.group = group
        self.variables = {name: Variable(a.shape, str(a.dtype)) for name, a in self._arrays().items()}
        for name in self._other_ways:
            self.variables[name] = self.variables["csi"]

    def csi(self, name: str) -> tuple[Tones, NDArray[np.complex64]]:
        """CSI (frames, antennas, subcarriers) by the name of its variable, and its subcarriers.

        Raises
        ------
        SetupError
            If there is none of that name.
        """
        group = self._group_of(name)
        if name in group.more:
            tones, values = group.more[name]
            return tones, values[:, :, 0]
        names = [_stream(n) for n in range(group.kind.streams)]
        wanted = "csi" if name in self._other_ways else name
        if wanted not in names:
            raise SetupError(
                f'{self.path} has no variable "{name}" with CSI; it has {", ".join((*names, *group.more))}'
            )
        return group.kind.tones, group.csi[:, :, names.index(wanted)]

    def _group_of(self, name: str) -> Group:
        """The frames chosen, decoded in another way if `name` says so."""
        if name not in self._other_ways:
            return self.group
        if name not in self._logs:
            self._logs[name] = self._other_ways[name](self._data)
        number = self.group.number[0]
        return next(group for group in self._logs[name].groups if number in group.number)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        order = [("ue", "antenna", "subcarrier").index(axis) for axis in self.axes]
        found: dict[str, NDArray[Any]] = {}
        streams = {_stream(n): self.group.csi[:, :, n] for n in range(self.group.kind.streams)}
        more = {name: csi[:, :, 0] for name, (_, csi) in self.group.more.items()}
        for name, csi in {**streams, **more}.items():
            found[name] = csi.transpose(order) if len(order) == 3 else csi[:, 0]
        columns = dict(self.group.columns)
        if not self.log.has_senders:
            columns.pop("ue", None)
        return found | columns

    def _read(self, name: str) -> NDArray[Any]:
        if name in self._other_ways:
            csi = self.csi(name)[1]
            order = [("ue", "antenna", "subcarrier").index(axis) for axis in self.axes]
            return csi.transpose(order)
        return self._arrays()[name]


def _stream(number: int) -> str:
    return f"csi_{number}" if number else "csi"
