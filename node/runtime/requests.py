"""Requests on their way through a running node, and the answers that the main process gives itself.

What can be asked, and what it answers, is `chachart.sinks.base.NodeAccess`; `set_method`, `spectrum`,
`start_recording` and `stop_recording` go on to the dispatcher, `spectrum` to the worker that has the UE.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from pydantic import ValidationError

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import RequestError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.wire import chart_body
from chachart.node.runtime.plan import Plan, estimator_problems

TIMEOUT_S = 5.0


def checked_method(plan: Plan, theta: str, rho: str) -> dict[str, Any]:
    """{theta, rho}, if the array can be charted with them.

    Raises
    ------
    RequestError
        If not.
    """
    try:
        estimator = type(plan.estimator).model_validate(
            {**plan.estimator.model_dump(), "theta": theta, "rho": rho}
        )
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise RequestError(f"{where} = {first['input']!r}: {first['msg']}"[:300]) from None
    if problems := estimator_problems(plan.array, estimator):
        raise RequestError(problems[0])
    return {"theta": theta, "rho": rho}


def ue_list(chart: ChartUpdate | None) -> dict[str, Any]:
    """See `NodeAccess.ues`."""
    if chart is None:
        return {"ues": []}
    rows = zip(*(values.tolist() for values in chart.columns.values()), strict=True)
    return {"ues": [dict(zip(chart.columns, row, strict=True)) for row in rows]}


def chart_columns(chart: ChartUpdate | None, array: ArrayGeometry) -> dict[str, Any]:
    """See `NodeAccess.chart_columns`."""
    if chart is None:
        return {}
    return {**chart_body(chart, 0), **chart.columns, "geometry": array.as_dict()}


class PendingRequests:
    """Requests that are on their way through the node. Thread-safe.

    Parameters
    ----------
    send
        Sends {id, operation, arguments} towards the workers.
    """

    def __init__(self, send: Callable[[dict[str, Any]], None]) -> None:
        self._send = send
        self._ids = itertools.count()
        self._waiting: dict[int, Future[dict[str, Any]]] = {}
        self._lock = threading.Lock()

    def ask(self, operation: str, arguments: dict[str, Any]) -> dict[str, Any]:
        """Send the request and wait for its answer.

        Raises
        ------
        RequestError
            If it is answered with an error, or not in time.
        """
        future: Future[dict[str, Any]] = Future()
        with self._lock:
            number = next(self._ids)
            self._waiting[number] = future
        try:
            self._send({"id": number, "operation": operation, "arguments": arguments})
            answer = future.result(TIMEOUT_S)
        except TimeoutError:
            raise RequestError(f"{operation} was not answered within {TIMEOUT_S:g} s") from None
        finally:
            with self._lock:
                del self._waiting[number]
        if "error" in answer:
            raise RequestError(answer["error"])
        result: dict[str, Any] = answer["result"]
        return result

    def answer(self, values: dict[str, Any]) -> None:
        """An answer came: the first one counts, one that nobody waits for does not."""
        with self._lock:
            future = self._waiting.get(values["id"])
            if future is not None and not future.done():
                future.set_result(values)
