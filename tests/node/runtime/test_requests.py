from __future__ import annotations

import threading
from typing import Any

import pytest

from chachart.node.data.errors import RequestError
from chachart.node.runtime import requests
from chachart.node.runtime.requests import PendingRequests


def answered_by(answer: dict[str, Any]) -> PendingRequests:
    """Requests that get that answer at once, from another thread."""

    def send(values: dict[str, Any]) -> None:
        threading.Thread(target=pending.answer, args=({"id": values["id"], **answer},)).start()

    pending = PendingRequests(send)
    return pending


def test_a_result_comes_back() -> None:
    assert answered_by({"result": {"theta": 1.0}}).ask("spectrum", {"ue": 7}) == {"theta": 1.0}


def test_an_error_is_raised() -> None:
    with pytest.raises(RequestError, match="UE 7 is not on the chart"):
        answered_by({"error": "UE 7 is not on the chart"}).ask("spectrum", {"ue": 7})


def test_what_is_not_answered_in_time_is_said_so_and_a_late_answer_harms_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(requests, "TIMEOUT_S", 0.01)
    sent: list[dict[str, Any]] = []
    pending = PendingRequests(sent.append)
    with pytest.raises(RequestError, match=r"spectrum was not answered within 0\.01 s"):
        pending.ask("spectrum", {"ue": 7})
    pending.answer({"id": sent[0]["id"], "result": {}})


def test_only_the_first_answer_counts() -> None:
    def send(values: dict[str, Any]) -> None:
        pending.answer({"id": values["id"], "result": {"n": 1}})
        pending.answer({"id": values["id"], "result": {"n": 2}})

    pending = PendingRequests(send)
    assert pending.ask("set_method", {}) == {"n": 1}
