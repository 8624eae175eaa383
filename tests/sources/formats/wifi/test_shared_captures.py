"""Small captures with what should come out of them; on a user's machine they are not there."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingReader
from chachart.sources.formats import open_capture
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, mac

FOLDER = Path(__file__).parents[5] / "shared" / "captures"
LISTED = FOLDER / "expected.json"
CASES: list[dict[str, Any]] = json.loads(LISTED.read_text())["files"] if LISTED.is_file() else []
WIFI = [case for case in CASES if case["format"] not in ("numpy", "tfrecord")]

pytestmark = pytest.mark.skipif(not CASES, reason=f"{LISTED} is not there")


def name_of(case: dict[str, Any]) -> str:
    return str(case["file"])


def opened(case: dict[str, Any]) -> WifiCapture:
    capture = open_capture(FOLDER / case["file"])
    assert isinstance(capture, WifiCapture)
    return capture


def expected(case: dict[str, Any]) -> dict[str, np.ndarray]:
    with np.load(FOLDER / case["values"]) as arrays:
        return dict(arrays)


def assert_holds(group: Group, right: dict[str, np.ndarray], prefix: str, start_ns: int) -> None:
    """That a group has the arrays whose names begin with `prefix`."""
    exact = f"{prefix}csi_exact" if f"{prefix}csi_exact" in right else f"{prefix}csi"
    np.testing.assert_allclose(group.csi, right[exact], rtol=1e-6)
    np.testing.assert_array_equal(group.number, right[f"{prefix}frame_number"])
    np.testing.assert_array_equal(group.columns["time"] - start_ns, right[f"{prefix}time_ns"])
    if f"{prefix}ue" in right:
        np.testing.assert_array_equal(group.columns["ue"], right[f"{prefix}ue"].astype(np.uint64))
    if group.kind.tones.numbers is not None and f"{prefix}subcarrier" in right:
        np.testing.assert_array_equal(group.kind.tones.numbers, right[f"{prefix}subcarrier"])
    for name in ("rssi", "agc", "noise", "fft", "frame_count", "invalid"):
        if prefix + name in right:
            np.testing.assert_array_equal(group.columns[name], right[prefix + name])
    if f"{prefix}rss_dbm" in right:
        np.testing.assert_allclose(group.columns["rssi_dbm"], right[f"{prefix}rss_dbm"], rtol=1e-5)
    for name in ("csi_htltf", "csi_stbc_htltf"):
        if prefix + name in right:
            tones, values = group.more[name]
            np.testing.assert_array_equal(values, right[prefix + name])
            np.testing.assert_array_equal(tones.numbers, right[f"{prefix}subcarrier{name[3:]}"])


@pytest.mark.parametrize("case", WIFI, ids=name_of)
def test_frames_of_every_kind(case: dict[str, Any]) -> None:
    capture, right, arrays = opened(case), case["right"], expected(case)
    kept = capture.group
    assert (capture.log.frames, len(kept)) == (right["frames_in_file"], right["frames_kept"])
    left_out = Counter(capture.log.left_out)
    for group in capture.log.groups:
        if group is not kept:
            left_out[group.kind.differs_in(kept.kind, capture.log.order)] += len(group)
    told = Counter[str]()
    for entry in right["left_out"]:
        told[entry["reason"]] += entry["frames"]
    assert left_out == told
    start_ns = int(kept.columns["time"][0])
    assert_holds(kept, arrays, "", start_ns)
    for n, _ in enumerate((entry for entry in right["left_out"] if "arrays" in entry), 1):
        number = arrays[f"other{n}_frame_number"]
        [group] = [g for g in capture.log.groups if np.array_equal(g.number, number)]
        assert_holds(group, arrays, f"other{n}_", start_ns)


@pytest.mark.parametrize("case", WIFI, ids=name_of)
def test_what_the_file_says_of_them(case: dict[str, Any]) -> None:
    capture, right = opened(case), case["right"]
    kind = capture.group.kind
    assert kind.shape == (right["antennas"], right["streams"], right["subcarriers"])
    numbers = None if kind.tones.numbers is None else list(kind.tones.numbers)
    assert numbers == right.get("subcarrier_indices")
    assert kind.tones.spacing_hz == right.get("subcarrier_spacing_hz")
    if "used_subcarrier_indices" in right:
        assert list(kind.tones.used) == right["used_subcarrier_indices"]
    if "pilot_subcarrier_indices" in right:
        assert list(kind.tones.weak) == right["pilot_subcarrier_indices"]
    assert (kind.carrier_hz, kind.bandwidth_hz) == (right.get("carrier_hz"), right.get("bandwidth_hz"))
    assert list(kind.antenna_names) == right.get("antenna_names", [])
    assert capture.log.has_senders == (right["senders"] is not None)


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_the_command_makes_that_recording(
    case: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right, arrays, out = case["right"], expected(case), tmp_path / "out.mcap"
    words = shlex.split(
        case["command"].replace("{file}", str(FOLDER / case["file"])).replace("out.mcap", str(out))
    )
    assert main(words[1:]) == 0
    told = capsys.readouterr().out
    for entry in right["left_out"]:
        assert f"({entry['reason']})" in told
    reader = RecordingReader(out)
    block = CsiBlock.concatenate(list(reader.blocks()))
    assert len(block) == right["frames_kept"]
    assert reader.note["left_out"] == dict(
        sum((Counter({e["reason"]: e["frames"]}) for e in right["left_out"]), Counter())
    )
    csi = arrays.get("csi_exact", arrays["csi"])[:, :, 0]
    if reader.array.tones is not None:
        places = np.searchsorted(arrays["subcarrier"], reader.array.tones)
        np.testing.assert_array_equal(arrays["subcarrier"][places], reader.array.tones)
        csi = csi[:, :, places]
        assert reader.array.subcarrier_spacing_hz == right["subcarrier_spacing_hz"]
    assert reader.array.carrier_hz == right.get("carrier_hz", reader.array.carrier_hz)
    # Each frame may have a real factor of its own: RSSI.
    factor = np.sum(block.csi * csi.conj(), axis=(1, 2)) / np.sum(np.abs(csi) ** 2, axis=(1, 2))
    assert (np.abs(factor.imag) < 1e-5 * factor.real).all()
    np.testing.assert_allclose(block.csi / factor.real[:, None, None], csi, atol=1e-5 * np.abs(csi).max())
    if right["senders"] is not None:
        assert {ue: name for ue, name in reader.facts.senders.items() if name != "not said"} == {
            sender["ue"]: sender["mac"] for sender in right["senders"]
        }
        for sender in right["senders"]:
            assert np.count_nonzero(block.ue == np.uint64(sender["ue"])) == sender["frames"]
            assert mac(sender["ue"]) == sender["mac"]
    if "time_ns" in arrays and case["format"] not in ("numpy", "tfrecord"):
        np.testing.assert_array_equal(block.time_ns - block.time_ns[0], arrays["time_ns"])


def test_one_transmitter_in_several_places(tmp_path: Path) -> None:
    cases = [case for case in CASES if "together" in case]
    table = tmp_path / "places.csv"
    rows = [f"{c['file']},{','.join(map(str, c['right']['position_m']))}" for c in cases]
    table.write_text("file,x,y,z\n" + "\n".join(rows))
    files = [str(FOLDER / case["file"]) for case in cases]
    options = ["--carrier-hz", "5.32e9", "--position-from", str(table)]
    assert main(["import", *files, str(tmp_path / "out.mcap"), *options]) == 0
    block = CsiBlock.concatenate(list(RecordingReader(tmp_path / "out.mcap").blocks()))
    assert len(block) == cases[0]["together"]["frames"]
    places = np.repeat([case["right"]["position_m"] for case in cases], 20, axis=0)
    np.testing.assert_array_equal(block.position, places.astype(np.float32))
    assert (np.diff(block.time_ns) >= 0).all()
