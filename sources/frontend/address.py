"""Who is who on a CAN bus."""

from __future__ import annotations

from collections import Counter

from pydantic import Field

from chachart.node.data.settings import Settings

MAX_STANDARD_ID = 0x7FF
MAX_EXTENDED_ID = 0x1FFFFFFF


class FrontEndAddress(Settings):
    """One front-end on a CAN bus. Identifiers above 0x7FF are extended ones (29 bits)."""

    id: int = Field(0x640, ge=0, le=MAX_EXTENDED_ID)
    """Identifier that it sends on."""
    reply_id: int = Field(0x648, ge=0, le=MAX_EXTENDED_ID)
    """Identifier that the node answers on (ISO-TP flow control)."""

    @property
    def name(self) -> str:
        """What it is called in the status: its identifier in hexadecimal."""
        return f"0x{self.id:X}"

    @property
    def extended(self) -> bool:
        """Whether identifiers of 29 bits are used."""
        return max(self.id, self.reply_id) > MAX_STANDARD_ID


def distinct(front_ends: tuple[FrontEndAddress, ...]) -> tuple[FrontEndAddress, ...]:
    """`front_ends`, once it is clear that no identifier has two uses and none mixes 11 and 29 bits.

    Raises
    ------
    ValueError
        If one has.
    """
    uses = Counter(i for f in front_ends for i in (f.id, f.reply_id))
    if twice := [f"0x{i:X}" for i, n in uses.items() if n > 1]:
        raise ValueError(f"each id and reply_id must be different: {', '.join(twice)} is used more than once")
    for f in front_ends:
        if f.extended and min(f.id, f.reply_id) <= MAX_STANDARD_ID:
            raise ValueError(f"id and reply_id of {f.name} must both be above 0x7FF, or neither")
    return front_ends
