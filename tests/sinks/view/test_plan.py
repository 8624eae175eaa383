from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest

from chachart.node.data.errors import RequestError
from chachart.sinks.view.plan import FloorPlan

PNG = b"\x89PNG\r\n\x1a\n" + bytes(20_000)
ANCHORS = ((0.0, 0.0, -10.0, 5.0), (100.0, 80.0, 10.0, -3.0))


def send(plan: FloorPlan, image: bytes, who: int = 1, piece: int = 9000) -> dict[str, Any]:
    answer: dict[str, Any] = {}
    for at in range(0, len(image), piece):
        data = base64.b64encode(image[at : at + piece]).decode()
        answer = plan.change({"op": "plan", "at": at, "data": data, "last": at + piece >= len(image)}, who)
    return answer


def test_an_image_and_its_anchors_are_kept(tmp_path: Path) -> None:
    plan = FloorPlan(tmp_path)
    assert plan.describe() is None
    with pytest.raises(RequestError, match="there is no plan"):
        plan.image()
    assert send(plan, PNG)["plan"]["anchors"] is None
    assert plan.image() == (PNG, "image/png")
    plan.change({"op": "plan", "anchors": ANCHORS}, 1)
    kept = FloorPlan(tmp_path).describe()
    assert kept is not None
    assert kept["anchors"] == ANCHORS
    assert send(plan, b"\xff\xd8\xff" + bytes(10))["plan"]["anchors"] is None, "another image, other anchors"
    plan.change({"op": "plan", "remove": True}, 1)
    assert plan.describe() is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"at": 0, "data": "!", "last": True}, "base64"),
        ({"at": 0, "data": base64.b64encode(b"<svg onload=x>").decode(), "last": True}, "PNG, JPEG or WebP"),
        ({"at": 9, "data": ""}, "begin again"),
        ({"anchors": (ANCHORS[0], ANCHORS[0])}, "must be apart"),
        ({"anchors": ((0, 0, float("nan"), 0), ANCHORS[1])}, "is changed by"),
        ({"path": "/etc/passwd"}, "is changed by"),
    ],
)
def test_nothing_else_is_kept(tmp_path: Path, request_: dict[str, Any], words: str) -> None:
    with pytest.raises(RequestError, match=words):
        FloorPlan(tmp_path).change({"op": "plan", **request_}, 1)
    assert list(tmp_path.iterdir()) == []


def test_two_who_send_at_once_do_not_mix(tmp_path: Path) -> None:
    plan = FloorPlan(tmp_path)
    first = base64.b64encode(PNG[:100]).decode()
    plan.change({"op": "plan", "at": 0, "data": first}, 1)
    send(plan, PNG, who=2)
    with pytest.raises(RequestError, match="begin again"):
        plan.change({"op": "plan", "at": 100, "data": first, "last": True}, 1)


def test_a_folder_that_takes_nothing(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="cannot be kept"):
        send(FloorPlan(tmp_path / "nowhere"), PNG)
