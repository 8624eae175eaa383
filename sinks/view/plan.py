"""A floor plan or map under the chart: an image, and two points of it whose places on the chart are known."""

from __future__ import annotations

import base64
import binascii
import json
import threading
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from chachart.node.data.errors import RequestError
from chachart.node.data.settings import Settings

MAX_BYTES = 8 * 1024**2
_KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_IMAGE, _ANCHORS = "plan.image", "plan.json"

Anchor = tuple[float, float, float, float]
"""Column and row in the image, in pixels from its upper left corner; x and y on the chart, in metres."""


class _Part(Settings):
    op: Literal["plan"]
    at: int = Field(ge=0, le=MAX_BYTES)
    data: str = Field(max_length=16 * 1024)
    last: bool = False


class _Anchors(Settings):
    op: Literal["plan"]
    anchors: tuple[Anchor, Anchor]


class _Remove(Settings):
    op: Literal["plan"]
    remove: Literal[True]


_REQUEST: TypeAdapter[_Part | _Anchors | _Remove] = TypeAdapter(
    Annotated[_Part | _Anchors | _Remove, Field(union_mode="left_to_right")]
)


class FloorPlan:
    """The plan in `folder`: `plan.image` and `plan.json`. Thread-safe."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._upload: tuple[int, bytearray] = (0, bytearray())

    def describe(self) -> dict[str, Any] | None:
        """`{version, anchors}`, anchors None where they are not set yet; None where there is no plan."""
        try:
            version = (self._folder / _IMAGE).stat().st_mtime_ns
        except OSError:
            return None
        try:
            anchors = json.loads((self._folder / _ANCHORS).read_text())["anchors"]
            checked = _Anchors(op="plan", anchors=anchors).anchors
        except (OSError, ValueError, KeyError, TypeError):
            checked = None
        return {"version": str(version), "anchors": checked}

    def image(self) -> tuple[bytes, str]:
        """The image and what kind it is.

        Raises
        ------
        RequestError
            If there is none.
        """
        try:
            image = (self._folder / _IMAGE).read_bytes()
        except OSError:
            raise RequestError("there is no plan") from None
        return image, _kind(image)

    def change(self, asked: dict[str, Any], who: int) -> dict[str, Any]:
        """A piece of a new image, new anchors, or no plan any more; `who` keeps uploads apart.

        Raises
        ------
        RequestError
            If the request does not fit, the image is none, or it cannot be written.
        """
        try:
            request = _REQUEST.validate_python(asked)
        except ValidationError:
            raise RequestError("a plan is changed by {at, data, last}, {anchors} or {remove}") from None
        try:
            with self._lock:
                if isinstance(request, _Part):
                    self._take(request, who)
                elif isinstance(request, _Anchors):
                    _check(request.anchors)
                    (self._folder / _ANCHORS).write_text(json.dumps({"anchors": request.anchors}))
                else:
                    for name in (_IMAGE, _ANCHORS):
                        (self._folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise RequestError(f"the plan cannot be kept in {self._folder}: {error.strerror}") from None
        return {"plan": self.describe()}

    def _take(self, part: _Part, who: int) -> None:
        if part.at == 0:
            self._upload = (who, bytearray())
        owner, image = self._upload
        if owner != who or part.at != len(image):
            raise RequestError("somebody else began to send a plan: begin again")
        try:
            image += base64.b64decode(part.data, validate=True)
        except binascii.Error:
            raise RequestError("data must be base64") from None
        if len(image) > MAX_BYTES:
            raise RequestError(f"a plan may have {MAX_BYTES} bytes")
        if part.last:
            _kind(bytes(image))
            (self._folder / _ANCHORS).unlink(missing_ok=True)
            whole = self._folder / f".{_IMAGE}.part"
            whole.write_bytes(image)
            whole.replace(self._folder / _IMAGE)
            self._upload = (0, bytearray())


def _kind(image: bytes) -> str:
    for magic, kind in _KINDS.items():
        if image.startswith(magic):
            return kind
    if image[:4] == b"RIFF" and image[8:12] == b"WEBP":
        return "image/webp"
    raise RequestError("a plan is a PNG, JPEG or WebP image")


def _check(anchors: tuple[Anchor, Anchor]) -> None:
    (a, b, c, d), (e, f, g, h) = anchors
    if max(abs(a - e), abs(b - f)) < 1 or max(abs(c - g), abs(d - h)) < 1e-3:
        raise RequestError("the two anchors must be apart, in the image and on the chart")
