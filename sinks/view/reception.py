"""What the page and the node say to each other over the WebSocket.

The node sends chart frames (binary, `chachart.sinks.view.frames`) and as JSON text `hello`, `status` and
`quality`. The page sends `{"id", "op", arguments}` and gets `{"type": "answer", "id", "result" | "error"}`.
Besides the operations of `chachart.sinks.operations`, `{"op": "stream", "on"}` stops and resumes charts,
`{"op": "sync"}` asks for the whole chart, `{"op": "past", "ago_s"}` for that of some time ago (then no other
flows until `stream` is on again), and `{"op": "curve"}` for TW and CT against K.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, get_args

import numpy as np
from websockets.exceptions import ConnectionClosed

from chachart.node.data.errors import RequestError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.net.limits import RateLimit
from chachart.node.net.security import Role
from chachart.sinks.operations import WHOLE, Operations
from chachart.sinks.plain import encoded
from chachart.sinks.view.curve import CurveKeeper
from chachart.sinks.view.frames import describe, encode_frame
from chachart.sinks.view.hub import Hub, Viewer
from chachart.sinks.view.plan import FloorPlan
from chachart.sinks.web.connection import WebConnection

REQUESTS_PER_S, REQUESTS_AT_ONCE = 20.0, 100
"""What a viewer may ask; one who asks more waits."""
TRY_AGAIN = 1013
"""Close code for a viewer too many."""


class Reception:
    """Looks after viewers, each from coming to going; one who asks too much only makes itself wait.

    Parameters
    ----------
    hub
        Where the charts come from.
    operations, curve
        What viewers may ask.
    max_viewers
        So many may be there at the same time.
    page_id
        Changes with the page's files, so that a page left open loads itself anew after an upgrade.
    plan
        What lies under the chart.
    told
        What else every viewer is told when it comes.
    """

    def __init__(
        self,
        hub: Hub,
        operations: Operations,
        curve: CurveKeeper,
        max_viewers: int,
        page_id: str,
        plan: FloorPlan,
        told: Mapping[str, Any],
    ) -> None:
        self._hub = hub
        self._operations = operations
        self._curve = curve
        self._max_viewers = max_viewers
        self._page_id = page_id
        self._plan = plan
        self._told = told
        self._pace = RateLimit(REQUESTS_PER_S, REQUESTS_AT_ONCE)

    async def welcome(self, connection: WebConnection) -> None:
        """One viewer, from coming to going."""
        if len(self._hub.viewers) >= self._max_viewers:
            await connection.close(TRY_AGAIN, "Too many people look at this node already.")
            return
        viewer = Viewer()
        viewer.text("hello", self._hello(connection.role))
        self._hub.viewers.add(viewer)
        sender = asyncio.create_task(viewer.run(connection, self._hub))
        try:
            async for message in connection:
                await asyncio.sleep(self._pace.wait_s(viewer))
                self._pace.take(viewer)
                await connection.send(await self._hear(viewer, message, connection.role))
        except ConnectionClosed:
            return
        finally:
            self._hub.viewers.discard(viewer)
            sender.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sender

    def _hello(self, role: Role) -> str:
        return json.dumps(
            {
                "type": "hello",
                "page": self._page_id,
                "may_steer": role >= Role.STEERER,
                "array": self._hub.array.as_dict(),
                "places": _places(self._hub.array),
                "pose": _pose(self._hub.arrays),
                "plan": self._plan.describe(),
                "columns": describe(),
                **self._told,
                "methods": {"theta": get_args(ThetaMethod), "rho": get_args(RhoMethod)},
                "rate_hz": self._hub.rate_hz,
                **self._hub.past(),
            }
        )

    async def _hear(self, viewer: Viewer, message: str | bytes, role: Role) -> str:
        """Carry out a viewer's message; the answer to it."""
        number = None
        try:
            asked = json.loads(message)
            if not isinstance(asked, dict):
                raise RequestError("a request is a JSON object")
            number = asked.pop("id", None)
            result = await self._obey(viewer, asked, role)
        except (RequestError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
            return json.dumps({"type": "answer", "id": number, "error": str(error)})
        return encoded({"type": "answer", "id": number, "result": result}).decode()

    async def _obey(self, viewer: Viewer, asked: dict[str, Any], role: Role) -> Mapping[str, Any]:
        if asked == {"op": "sync"}:
            viewer.start_over()
            return {}
        if asked == {"op": "curve"}:
            return await self._curve.get()
        if asked.get("op") == "plan":
            if role < Role.STEERER:
                raise RequestError("who may only read changes no plan")
            return await asyncio.to_thread(self._plan.change, asked, id(viewer))
        if asked.get("op") == "past":
            return await asyncio.to_thread(self._look_back, viewer, asked.get("ago_s"))
        if asked.get("op") == "stream" and type(asked.get("on")) is bool:
            viewer.flow(asked["on"])
            return {}
        if asked in WHOLE:
            await asyncio.sleep(viewer.until_next_whole())
        return await asyncio.to_thread(self._operations.perform, asked, role)

    def _look_back(self, viewer: Viewer, ago_s: Any) -> dict[str, Any]:
        if type(ago_s) not in (int, float) or not ago_s >= 0:
            raise RequestError(f"ago_s must be how many seconds ago, not {ago_s!r}"[:200])
        chart = self._hub.history.at(ago_s)
        if chart is None:
            raise RequestError(f"nothing is known of {ago_s:.0f} s ago")
        viewer.look_back(encode_frame(chart, self._hub.array, full=True))
        return {"ues": len(chart), "history_s": self._hub.history.seconds()}


def _places(array: ArrayGeometry) -> list[list[float]] | None:
    """Where elements are, to the right and up (of a flat array: away), seen from the front.

    None of a line, where their numbers say it.
    """
    if array.is_line:
        return None
    own = array.own_elements
    spread = np.ptp(own, axis=0)
    places: list[list[float]] = own[:, [0, 1 if spread[1] >= spread[2] else 2]].round(4).tolist()
    return places


def _pose(arrays: Sequence[ArrayGeometry]) -> dict[str, Any]:
    """Where `arrays` are in the world, the directions of their rows, and where they look.

    A line that is charted on its own has a chart of its own: `world` is False then.
    """
    posed = []
    for array in arrays:
        at, along, normal = (v[:2].round(4).tolist() for v in (array.centre_m, array.right, array.normal))
        posed.append({"name": array.name, "at": at, "along": along, "normal": normal})
    return {"arrays": posed, "world": len(arrays) > 1 or not arrays[0].is_line}
