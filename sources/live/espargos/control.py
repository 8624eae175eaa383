"""What an ESPARGOS controller is asked, and what its answers mean, whichever way they come."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from chachart.node.data.errors import SetupError

API_MAJOR = 3
REFERENCE, ANTENNAS = 1, 2
"""States of the switch before the sensors: the reference signal, and the antennas (feed R)."""
ACQUIRE = {
    "enable": True,
    "acquire_csi_legacy": True,
    "acquire_csi_force_lltf": True,
    "compress_csi": False,
    "lltf_8bit_mode": False,
}
"""Every OFDM packet gives an L-LTF estimate of 12 bits, whatever its own format."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A Wi-Fi channel in the 2.4 GHz band: primary 1 to 13, secondary 0 (none), 1 (above) or -1 (below)."""

    primary: int
    secondary: int

    @property
    def packet_hz(self) -> float:
        """Middle of 20 MHz packets, which tones count from."""
        return 2.407e9 + 5e6 * self.primary

    @property
    def centre_hz(self) -> float:
        """Middle of the radio's band."""
        return self.packet_hz + 10e6 * self.secondary


class Controller(ABC):
    """One controller.

    Parameters
    ----------
    name
        What it is called in messages: its address or port.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def ask(self, method: str, path: str, body: str = "") -> tuple[int, str]:
        """Status and text of the answer to a request.

        Raises
        ------
        SetupError
            If there is none.
        """

    def identify(self) -> dict[str, Any]:
        """What it is.

        Raises
        ------
        SetupError
            If it does not answer, or is no ESPARGOS controller whose interface is known.
        """
        info = self._json("/api_info")
        if info.get("device") != "espargos" or info.get("api-major") != API_MAJOR:
            raise SetupError(
                f'[source] "{self.name}" is no ESPARGOS controller of interface {API_MAJOR}, but says {info}'[
                    :300
                ]
            )
        return info

    def channel(self) -> Channel:
        """The channel it listens on.

        Raises
        ------
        SetupError
            If it does not answer, or answers nonsense.
        """
        conf = self._json("/get_wificonf")
        primary, secondary = conf.get("channel-primary"), conf.get("channel-secondary", 0)
        if not isinstance(primary, int) or not 1 <= primary <= 14 or secondary not in (0, 1, 2):
            raise SetupError(f'[source] "{self.name}" says it listens on channel {primary!r}, {secondary!r}')
        return Channel(primary, (0, 1, -1)[secondary])

    def acquire(self) -> None:
        """Have it measure what the source understands."""
        self.tell("/set_csi_acquire_config", json.dumps(ACQUIRE))

    def switch(self, state: int) -> None:
        """Connect the sensors to the reference or to the antennas."""
        self.tell("/set_rfswitch", str(state))

    def tell(self, path: str, body: str) -> None:
        """Have it do something.

        Raises
        ------
        SetupError
            If it does not answer, or refuses.
        """
        self._accepted(path, *self.ask("POST", path, body))

    def _json(self, path: str) -> dict[str, Any]:
        answer = self._accepted(path, *self.ask("GET", path))
        try:
            values = json.loads(answer)
        except ValueError:
            values = None
        if not isinstance(values, dict):
            raise SetupError(
                f'[source] "{self.name}" answers {path} with {answer[:80]!r}, which is no JSON table'
            )
        return values

    def _accepted(self, path: str, status: int, text: str) -> str:
        if status != 200:
            raise SetupError(f'[source] "{self.name}" refuses {path}: {status} {text[:80]}')
        return text
