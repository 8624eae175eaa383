"""CSI in MCAP files: what the recorder and `chachart import` write, and what a recording source reads.

The layout, for whoever reads such a file with another tool:

- A Metadata record `chachart.csi` stands at the start, so that it survives a kill: `format` ("1"), `array`
  (JSON, the fields of `ArrayGeometry`, calibration included), `others` (JSON, a list of further arrays, where
  several measured; each frame says whose it is), `note` (JSON, what the writer had to say) and
  `facts` (JSON, what phase and delay mean and who the UEs are; older recordings have none).
- Chunks of 256 KiB, by default without compression: CSI is mostly noise to a compressor. Each goes to the
  operating system when it is full: a writer that is killed loses its last chunk and nothing else.
- One channel `csi`, one message a block of up to 64 frames: a msgpack map with the fields of a protocol 1 CSI
  header and the samples themselves as `csi` (raw little-endian, antennas by subcarriers, frame after frame).
  `log_time` is the time of the block's earliest frame, `publish_time` that of its latest.
- On closing, a Metadata record `chachart.totals`: `frames`, `ues`, `start_ns`, `end_ns`, `span_ns` (the
  longest time that one message covers), then MCAP's own summary with the time of every chunk.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.chart_log import is_chart_log
from chachart.node.files.cuts import between, joined
from chachart.node.files.foreign import contents
from chachart.node.files.mcap_chunks import ChunkSpan, DamagedChunk, FileIndex, read_index, read_messages
from chachart.node.files.mcap_writer import McapWriter, OutgoingMessage
from chachart.node.files.recording_totals import Account, RecordingSummary, Totals, density
from chachart.node.files.whole_file import WholeFile
from chachart.node.net.wire import WireError, decode_csi_map, encode_csi_map

FORMAT = "1"
MESSAGE_FRAMES = 64
MESSAGE_BYTES = 4 * 1024 * 1024

_HEAD = "chachart.csi"
_TOTALS = "chachart.totals"
_SCHEMA = b"""A msgpack map: v (1), type ("csi"), array (str), seq (int, number of the first frame),
shape ([frames, antennas, subcarriers]), dtype ("<c8"), ue (bin, <u8 a frame), time_ns (bin, <i8 a frame),
position (bin, three <f4 a frame, metres; may be absent), packet (bin, <u8 a frame, shared by the frames of a
transmission at all arrays; may be absent), csi (bin, the samples in the order of shape).
"""


class RecordingWriter:
    """Writes the CSI of an array, or of several, to a new file.

    Parameters
    ----------
    path
        The file; it must not exist yet.
    array
        The array that measured the CSI; kept in the file, so that the recording alone is enough to replay.
    note
        Anything else worth keeping, plain JSON values.
    facts
        What phase and delay mean and who the UEs are; not given: a coherent array with a clock.
    others
        Further arrays, each with a name of its own.
    zstd
        Whether chunks are compressed, where that makes them shorter.
    chunk_bytes
        A chunk goes to the operating system when it holds so much.

    Raises
    ------
    SetupError
        If the file exists already or cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        array: ArrayGeometry,
        *,
        note: Mapping[str, Any] | None = None,
        facts: CaptureFacts | None = None,
        others: Sequence[ArrayGeometry] = (),
        zstd: bool = False,
        chunk_bytes: int = 256 * 1024,
    ) -> None:
        self.path = Path(path)
        self.array = array
        self._shapes = {a.name: (a.antennas, a.subcarriers) for a in (array, *others)}
        self._account = Account()
        self._chunk_bytes = chunk_bytes
        self._gathered: list[CsiBlock] = []
        self._gathered_bytes = 0
        try:
            self._file = WholeFile(self.path)
        except FileExistsError:
            raise SetupError(f"{path} exists already; recordings are never overwritten") from None
        except OSError as error:
            raise SetupError(f"cannot write {path}: {error.strerror}") from None
        try:
            self._writer = McapWriter(self._file, "csi", "msgpack", "chachart.csi", _SCHEMA, zstd=zstd)
            head = {"format": FORMAT, "array": json.dumps(array.as_dict()), "note": json.dumps(note or {})}
            head["facts"] = json.dumps((facts or CaptureFacts()).as_dict())
            if others:
                head["others"] = json.dumps([other.as_dict() for other in others])
            self._writer.add_metadata(_HEAD, head)
        except OSError as error:
            self._file.close()
            self.path.unlink(missing_ok=True)
            raise SetupError(f"cannot write {path}: {error.strerror}") from None

    def write(self, block: CsiBlock) -> None:
        """Append a block: a long one becomes several messages, short ones that follow each other become one.

        Raises
        ------
        ValueError
            If the block does not have its array's antennas and subcarriers.
        OSError
            If the disk takes no more.
        """
        fits = self._shapes.get(block.array, (self.array.antennas, self.array.subcarriers))
        if (block.antennas, block.subcarriers) != fits:
            raise ValueError(
                f"a recording of {fits[0]} x {fits[1]} takes no frames of "
                f"{block.antennas} x {block.subcarriers}"
            )
        self._gathered.append(block)
        self._gathered_bytes += block.csi.nbytes
        if self._gathered_bytes >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Hand what there is to the operating system, however short a chunk it makes.
        Raises OSError if the disk takes no more: the file ends with its last whole chunk, the rest is lost.
        """
        blocks, self._gathered, self._gathered_bytes = self._gathered, [], 0
        pieces: list[CsiBlock] = []
        size = 0
        for block in joined(blocks):
            step = max(1, min(MESSAGE_FRAMES, MESSAGE_BYTES // block.csi[0].nbytes))
            for start in range(0, len(block), step):
                pieces.append(block.cut(start, start + step))
                size += pieces[-1].csi.nbytes
                if size >= self._chunk_bytes:
                    self._add_chunk(pieces)
                    pieces, size = [], 0
        if pieces:
            self._add_chunk(pieces)

    def _add_chunk(self, pieces: list[CsiBlock]) -> None:
        messages = []
        for piece in pieces:
            # MCAP's times are unsigned; the frames keep their own.
            first, last = (max(int(time_ns), 0) for time_ns in (piece.time_ns.min(), piece.time_ns.max()))
            messages.append(OutgoingMessage(first, last, encode_csi_map(piece)))
        self._writer.add_chunk(messages)
        for piece in pieces:
            self._account.add(piece)

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return self._account.frames + sum(len(block) for block in self._gathered)

    @property
    def kept(self) -> int:
        """Frames in whole chunks."""
        return self._account.frames

    @property
    def bytes_written(self) -> int:
        """Size of the file so far; the chunk in progress does not count yet."""
        return self._writer.bytes_written

    def close(self) -> None:
        """Write the totals and the index, and close the file. May be called twice.

        Raises OSError if the disk takes no more: the file ends with its last whole chunk, and can be read.
        """
        if self._file.closed:
            return
        with self._file:
            self.flush()
            totals = asdict(self._account.totals())
            self._writer.add_metadata(_TOTALS, {name: json.dumps(value) for name, value in totals.items()})
            self._writer.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class RecordingReader:
    """Reads a recording, closed properly or cut off anywhere.

    No file stays open between calls. What is damaged is left out.

    Attributes
    ----------
    array, note, facts
        The array (the first of several), the note, and the facts in the file.
    arrays
        All of them.
    damaged
        Chunks and messages that `blocks` left out, by reason.

    Raises
    ------
    SetupError
        If there is no such file, or it is no recording of CSI.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.damaged = Counters()
        self._damaged_in_all = Counters()
        if is_chart_log(self.path):
            raise SetupError(f"{path} is a chart log and holds no CSI; a recording is needed")
        self._index: FileIndex = read_index(self.path)
        self._totals = Totals.parse(self._index.metadata.get(_TOTALS, {}))
        self.arrays, self.note, self.facts = self._head()
        self.array = self.arrays[0]
        self._shapes = {a.name: (a.antennas, a.subcarriers) for a in self.arrays}

    def _head(self) -> tuple[tuple[ArrayGeometry, ...], dict[str, Any], CaptureFacts]:
        head = self._index.metadata.get(_HEAD)
        if head is None:
            what = "holds no CSI" if self._index.closed else "was cut off before its description of the array"
            found = contents(self.path)
            held = f"{what} (it has {found})" if found else what
            raise SetupError(f"{self.path} is an MCAP file, but {held}; a recording of chachart is needed")
        if head.get("format") != FORMAT:
            raise SetupError(f"{self.path} has recording format {head.get('format')}; this is for {FORMAT}")
        try:
            array, note = json.loads(head["array"]), json.loads(head["note"])
            facts = CaptureFacts.from_dict(json.loads(head.get("facts", "{}")))
            arrays = [ArrayGeometry.from_dict(a) for a in (array, *json.loads(head.get("others", "[]")))]
            return tuple(arrays), dict(note), facts
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            raise SetupError(f"{self.path} does not describe its array: {error}") from None

    @property
    def closed_properly(self) -> bool:
        """False where the writer was killed (or still writes)."""
        return self._index.closed

    @property
    def start_ns(self) -> int | None:
        """Time of the earliest frame, None in an empty recording; needs no reading of frames."""
        if self._totals is not None:
            return self._totals.start_ns
        return min((chunk.start_ns for chunk in self._index.chunks), default=None)

    @property
    def end_ns(self) -> int | None:
        """Time of about the latest frame, as `start_ns`."""
        if self._totals is not None:
            return self._totals.end_ns
        return max((chunk.end_ns for chunk in self._index.chunks), default=None)

    def density(self, bins: int) -> list[float]:
        """Which share of it lies in each of so many equal parts of its time, from the index alone."""
        if self.start_ns is None or self.end_ns is None:
            return [0.0] * bins
        return density(self._index.chunks, self.start_ns, self.end_ns, bins)

    def summary(self) -> RecordingSummary:
        """What the recording holds; a file without totals is read through, once."""
        if self._totals is None:
            account = Account()
            for block in self._read(None, None, self._damaged_in_all):
                account.add(block)
            self._totals = account.totals()
        return RecordingSummary(
            array=self.array,
            note=self.note,
            facts=self.facts,
            frames=self._totals.frames,
            ues=self._totals.ues,
            start_ns=self._totals.start_ns,
            end_ns=self._totals.end_ns,
            closed_properly=self.closed_properly,
            damaged=self._damaged_in_all.as_dict(),
            size=self.path.stat().st_size,
        )

    def blocks(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[CsiBlock]:
        """The blocks in the order of the file, cut to frames of `start_ns <= time_ns < end_ns`.

        The arrays of a block are read-only. What is damaged is counted in `damaged`.
        """
        return self._read(start_ns, end_ns, self.damaged)

    def _read(self, start_ns: int | None, end_ns: int | None, damaged: Counters) -> Iterator[CsiBlock]:
        with self.path.open("rb") as file:
            for chunk in self._chunks(start_ns, end_ns):
                try:
                    for message in read_messages(file, chunk):
                        if start_ns is not None and message.publish_ns < start_ns:
                            continue
                        if end_ns is not None and message.log_ns >= max(end_ns, 1):
                            continue
                        block = self._block(message.data, damaged)
                        block = None if block is None else between(block, start_ns, end_ns)
                        if block is not None:
                            yield block
                except DamagedChunk as error:
                    damaged.add(error.reason)

    def _chunks(self, start_ns: int | None, end_ns: int | None) -> Iterator[ChunkSpan]:
        """The chunks that can hold frames of this time; without totals, a message may last any time."""
        totals = self._totals
        for chunk in self._index.chunks:
            if start_ns is not None and totals is not None and chunk.end_ns + totals.span_ns < start_ns:
                continue
            if end_ns is None or chunk.start_ns < max(end_ns, 1):
                yield chunk

    def _block(self, data: memoryview, damaged: Counters) -> CsiBlock | None:
        try:
            block = decode_csi_map(data)
        except WireError as error:
            damaged.add(error.reason)
            return None
        fits = self._shapes.get(block.array, self._shapes[self.array.name])
        if (block.antennas, block.subcarriers) != fits:
            damaged.add("shape")
            return None
        return block
