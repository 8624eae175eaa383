from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from chart_samples import StillNode

from chachart.node.data.errors import RequestError
from chachart.node.net.security import Role
from chachart.sinks.operations import Operations


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"op": "method", "theta": "musik", "rho": "music"}, 'theta must be one of .*; did you mean "music"'),
        ({"op": "set_method", "theta": "music", "rho": "x"}, "rho must be one of bartlett, .*lr"),
        ({"op": "start_recording", "path": "../a"}, "path: must be a file name that ends in .mcap"),
        ({"op": "reboot"}, "op must be one of status, ues"),
    ],
)
def test_mistakes_are_told_in_plain_words(tmp_path: Path, request_: dict[str, Any], words: str) -> None:
    with pytest.raises(RequestError, match=words):
        Operations(StillNode(), tmp_path).perform(request_)


def test_who_may_only_look_winds_no_replay(tmp_path: Path) -> None:
    operations = Operations(StillNode(), tmp_path)
    with pytest.raises(RequestError, match="may only read"):
        operations.perform({"op": "replay", "paused": True}, Role.READER)
