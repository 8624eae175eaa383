"""Names of UEs for people, from a CSV file: a UE's number or MAC address, then its name."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from chachart.node.data.errors import SetupError

MOST = 100_000
_MAC = re.compile(r"([0-9a-f]{2})(?:[:-]([0-9a-f]{2})){5}", re.IGNORECASE)


def load_names(path: Path) -> dict[int, str]:
    """The names in the file, by UE; a first line of headings, and empty ones, are passed over.

    Raises
    ------
    SetupError
        If it cannot be read, or a line names no UE.
    """
    names: dict[int, str] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for number, row in enumerate(csv.reader(file), 1):
                if len(row) < 2 or not row[0].strip():
                    continue
                ue = ue_number(row[0])
                if ue is not None:
                    names[ue] = row[1].strip()[:64]
                elif number > 1:
                    raise SetupError(
                        f"{path}, line {number}: {row[0]!r} is no UE's number and no MAC address"
                    )
                if len(names) > MOST:
                    raise SetupError(f"{path} has more than {MOST} names")
    except OSError as error:
        raise SetupError(f"cannot read {path}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise SetupError(f"{path} is no CSV file: {error}") from None
    return names


def ue_number(text: str) -> int | None:
    """The UE that `text` names: `17`, `0x1f` or a MAC address, most significant byte first; else None."""
    text = text.strip()
    if _MAC.fullmatch(text):
        return int(re.sub("[:-]", "", text), 16)
    try:
        ue = int(text, 0)
    except ValueError:
        return None
    return ue if 0 <= ue < 2**64 else None
