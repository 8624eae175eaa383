"""What a capture file is to the importer: named variables that are read when asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from chachart.node.data.errors import SetupError

HEAD_BYTES = 4096
"""So much of a file's beginning a format is shown to recognise it by."""


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable's shape and the name of its type, known without reading it."""

    shape: tuple[int, ...]
    dtype: str

    def __str__(self) -> str:
        return f"{self.dtype} ({', '.join(map(str, self.shape))})"


class Capture(ABC):
    """An opened capture file.

    Attributes
    ----------
    path, format
        The file, and what its format is called.
    axes
        What the axes of its CSI are where nobody says otherwise.
    variables
        What it holds, by name.
    left_out
        How many frames of it cannot be read, by reason.
    """

    format: str
    axes: tuple[str, ...] = ("ue", "antenna", "subcarrier")

    def __init__(self, path: Path, variables: Mapping[str, Variable]) -> None:
        self.path = path
        self.variables = dict(variables)
        self.left_out: Counter[str] = Counter()

    def read(self, name: str) -> NDArray[Any]:
        """The variable called `name`.

        Raises
        ------
        SetupError
            If there is none, or its data are damaged; the message lists what the file has.
        """
        if name not in self.variables:
            raise SetupError(f'{self.path} has no variable "{name}"; it has {self.listing()}')
        return self._read(name)

    def listing(self) -> str:
        """Every variable with its type and shape, as one phrase."""
        return ", ".join(f"{name}: {variable}" for name, variable in self.variables.items()) or "none"

    @abstractmethod
    def _read(self, name: str) -> NDArray[Any]:
        """The variable called `name`, which exists."""

    def damaged(self, error: object) -> SetupError:
        """The error to raise for data that cannot be read."""
        return SetupError(f"{self.path} is damaged or cut short: {error}")
