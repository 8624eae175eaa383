from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wifi_captures import ESP32_HEADINGS, esp32, esp32_line, integers

from chachart.sources.formats.wifi.esp32 import read, why_not
from chachart.sources.formats.wifi.esp32_lines import lines as parsed_lines
from chachart.sources.formats.wifi.log import Log
from chachart.sources.formats.wifi.tones import carrying

CSI = integers(5, 64)


def log_of(text: str | bytes) -> Log:
    return read(np.frombuffer(text.encode() if isinstance(text, str) else text, np.uint8))


def lines(csi: np.ndarray, **options: int) -> str:
    return "\n".join(esp32_line(frame, n, **options) for n, frame in enumerate(csi)) + "\n"


def test_values_columns_and_the_clock_that_wraps() -> None:
    log = log_of(esp32(CSI))
    [group] = log.groups
    np.testing.assert_array_equal(group.csi[:, 0, 0], np.fft.fftshift(CSI, axes=1))
    np.testing.assert_array_equal(np.diff(group.columns["time"]), 20_000)
    assert group.kind.tones.numbers == tuple(range(-32, 32))
    assert len(group.kind.tones.used) == 52
    assert group.kind.carrier_hz == 2.437e9
    assert set(group.columns["ue"].tolist()) == {0x0200_0000_0001}
    assert set(group.columns["rssi_dbm"].tolist()) == {-40}


@pytest.mark.parametrize("quoted", [True, False])
@pytest.mark.parametrize("packed64", [True, False])
def test_ways_to_write_the_list(quoted: bool, packed64: bool) -> None:
    csi = integers(3, 52)
    [group] = log_of(lines(csi, quoted=quoted, packed64=packed64)).groups
    np.testing.assert_array_equal(group.csi[:, 0, 0], csi)
    assert group.kind.tones.numbers is None, "nobody says the numbers of 52 values"


@pytest.mark.parametrize(
    ("secondary", "first", "carrier_hz"), [(0, -32, 2.437e9), (1, -64, 2.447e9), (2, 0, 2.427e9)]
)
def test_where_the_secondary_channel_is(secondary: int, first: int, carrier_hz: float) -> None:
    [group] = log_of(lines(CSI, secondary=secondary)).groups
    assert group.kind.tones.numbers == tuple(range(first, first + 64))
    assert group.kind.carrier_hz == carrier_hz


@pytest.mark.parametrize(
    ("secondary", "count", "sizes"),
    [
        (0, 128, [64, 64]),
        (0, 192, [64, 64, 64]),
        (2, 192, [64, 128]),
        (1, 192, [64, 128]),
        (2, 190, [64, 63, 63]),
        (1, 188, [64, 62, 62]),
        (2, 306, [64, 121, 121]),
    ],
)
def test_training_fields_in_one_list(secondary: int, count: int, sizes: list[int]) -> None:
    csi = integers(2, count)
    [group] = log_of(lines(csi, secondary=secondary)).groups
    fields = [("csi", group.kind.tones, group.csi), *((n, t, v) for n, (t, v) in group.more.items())]
    assert [values.shape[3] for _, _, values in fields] == sizes
    start = 0
    for _, tones, values in fields:
        native = csi[:, start : start + values.shape[3]]
        assert set(values[0, 0, 0].tolist()) == set(native[0].astype(np.complex64).tolist())
        assert tones.numbers is not None
        assert list(tones.numbers) == sorted(tones.numbers)
        start += values.shape[3]


def test_values_of_an_invalid_first_word_are_marked() -> None:
    text = lines(CSI, first_word=1) + lines(CSI)
    [group] = log_of(text).groups
    assert np.flatnonzero(group.columns["invalid"][0]).tolist() == [32, 33], "tones 0 and 1"
    assert not group.columns["invalid"][5:].any()
    assert group.kind.tones.weak == (1,)


def test_the_same_length_with_other_subcarriers_is_another_kind() -> None:
    log = log_of(lines(CSI) + lines(CSI[:2], secondary=2))
    assert [len(group) for group in log.groups] == [5, 2]
    assert log.groups[1].kind.differs_in(log.groups[0].kind, log.order) == "other subcarriers"


@pytest.mark.parametrize(
    "broken",
    [
        lambda line: line[:-9],
        lambda line: line.replace(",11,", ",x,", 1).replace(",-40,", ",-4o,"),
        lambda line: line.replace("02:00:00:00:00:01", "02:00:00:00"),
        lambda line: line.replace('"[', '"[1,'),
        lambda line: line.replace(",-95,", ",", 1),
        lambda line: line.replace('"[', '"[99999999999999999999,1,'),
        lambda line: line[: len(line) // 2] + "I (99) wifi: a message" + line[len(line) // 2 :],
    ],
)
def test_a_broken_line_costs_itself(broken: object) -> None:
    good = lines(CSI).splitlines()
    good[2] = broken(good[2])  # type: ignore[operator]
    log = log_of("\n".join(good))
    np.testing.assert_array_equal(log.groups[0].number, [0, 1, 3, 4])
    assert (dict(log.left_out), log.frames) == ({"broken line": 1}, 5)


def test_headings_name_the_columns() -> None:
    swapped = ESP32_HEADINGS.replace("local_timestamp,ant", "ant,local_timestamp")
    text = swapped + "\n" + lines(CSI, clock=77).replace(",77,0,", ",0,77,")
    [group] = log_of(text).groups
    assert (group.columns["time"] == 77_000).all()


def test_15_columns_of_the_c5() -> None:
    values = np.stack([CSI[:, :57].imag, CSI[:, :57].real], -1).astype(int).reshape(5, -1)
    rows = [
        f"CSI_DATA,{n},02:00:00:00:00:01,-30,11,-96,32,11,36,{1000 + n},47,0,114,0,"
        f'"[{",".join(map(str, row))}]"'
        for n, row in enumerate(values)
    ]
    [group] = log_of("\n".join(rows)).groups
    assert group.kind.tones.numbers == tuple(range(-28, 29))
    np.testing.assert_array_equal(group.csi[:, 0, 0, 28:], CSI[:, :29])
    assert (group.kind.carrier_hz, group.columns["agc"][0], group.columns["fft"][0]) == (5.18e9, 11, 32)
    np.testing.assert_array_equal(group.columns["time"], (1000 + np.arange(5)) * 1000)


def test_a_log_whose_first_frame_comes_late_is_recognised() -> None:
    text = b"I (100) boot: something\r\n" * 300
    assert why_not(text[:4096]) is None
    assert why_not(b"short text") is not None
    assert why_not(bytes(4096)) is not None
    assert len(log_of(text + esp32(CSI)).groups[0]) == 5


def c5_lines(csi: np.ndarray, channel: int = 36) -> str:
    values = np.stack([csi.imag, csi.real], -1).astype(int).reshape(len(csi), -1)
    return "\n".join(
        f"CSI_DATA,{n},02:00:00:00:00:01,-30,11,-96,32,11,{channel},{1000 + n},47,0,{len(row)},0,"
        f'"[{",".join(map(str, row))}]"'
        for n, row in enumerate(values)
    )


@pytest.mark.parametrize(
    ("count", "packet_format", "mhz", "fields"),
    [
        (53, "legacy", 20, 1),
        (57, "ht", 20, 1),
        (114, "ht", 20, 2),
        (117, "ht", 40, 1),
        (234, "ht", 40, 2),
        (245, "he", 20, 1),
        (64, "ht", 20, 1),
        (128, "ht", 40, 1),
        (128, "ht", 20, 2),
        (256, "he", 20, 1),
    ],
)
@pytest.mark.parametrize("ascending", [False, True])
def test_lists_without_secondary_channel(
    count: int, packet_format: str, mhz: int, fields: int, ascending: bool
) -> None:
    size = count // fields
    half = -(-size // 2)
    native = [*range(half), *range(half - size, 0)]
    if ascending:
        native.sort()
    used = carrying(packet_format, mhz)
    csi = np.tile(np.array([complex(n, 1) if n in used else 0 for n in native]), (4, fields))
    [group] = log_of(c5_lines(csi)).groups
    tones = group.kind.tones
    assert tones.numbers == tuple(sorted(native))
    assert tones.used == used
    assert tones.spacing_hz == (78_125 if packet_format == "he" else 312_500)
    assert len(group.more) == fields - 1
    for values in (group.csi, *(more for _, more in group.more.values())):
        there = np.isin(tones.numbers, used)
        np.testing.assert_array_equal(values[0, 0, 0, there].real, used)
    assert group.kind.carrier_hz == (None if mhz == 40 else 5.18e9), "nobody says where the other half is"


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line + ",1600000000.25",
        lambda line: line + ',"[1.5, 2.5]",walk,1',
        lambda line: "2024-05-01 12:00:00: " + line,
        lambda line: "17," + line,
        lambda line: line.replace(",77,", ",77.0,", 1).replace(",-40,", ",-40.0,", 1),
        lambda line: line.replace("02:00:00:00:00:01", "2:0:0:0:0:1"),
        lambda line: line.replace("02:00:00:00:00:01", "02-00-00-00-00-01"),
        lambda line: '"' + line.replace("CSI_DATA,", 'CSI_DATA",'),
    ],
)
def test_what_loggers_and_spreadsheets_do_to_a_line(change: object) -> None:
    text = "\n".join(change(line) for line in lines(CSI, clock=77).splitlines())  # type: ignore[operator]
    for heading in ("", ESP32_HEADINGS + ",machine_timestamp\n"):
        [group] = log_of(heading + text).groups
        np.testing.assert_array_equal(group.csi[:, 0, 0], np.fft.fftshift(CSI, axes=1))
        assert set(group.columns["ue"].tolist()) == {0x0200_0000_0001}
        assert set(group.columns["time"].tolist()) == {77_000}


def test_headings_name_columns_that_no_tool_has() -> None:
    swapped = ESP32_HEADINGS.replace("local_timestamp,", "local_timestamp,esp_epoch_us,")
    text = swapped + "\n" + lines(CSI, clock=77).replace(",77,", ",77,1600000000000000,")
    [group] = log_of(text).groups
    assert set(group.columns["time"].tolist()) == {77_000}
    swapped = ESP32_HEADINGS.replace("local_timestamp,", "device_timestamp,local_timestamp,")
    text = swapped + "\n" + lines(CSI, clock=77).replace(",77,", ",77,2025-11-13 17:39:42.845,")
    assert set(log_of(text).groups[0].columns["time"].tolist()) == {77_000}


def test_lines_without_their_mark() -> None:
    text = ESP32_HEADINGS.removeprefix("type,id,") + "\n"
    text += "\n".join(line.split(",", 2)[2] for line in lines(CSI).splitlines())
    assert why_not(text.encode()) is None
    [group] = log_of(text).groups
    np.testing.assert_array_equal(group.csi[:, 0, 0], np.fft.fftshift(CSI, axes=1))


def test_a_clock_printed_as_a_signed_number() -> None:
    text = "".join(lines(CSI[:1], clock=clock) for clock in (2**31 - 5, 5 - 2**31, 15 - 2**31))
    [group] = log_of(text).groups
    assert np.diff(group.columns["time"]).tolist() == [10_000, 10_000]


def test_two_lines_that_ran_into_each_other_are_two() -> None:
    first, second = lines(CSI[:2]).splitlines()
    log = log_of(first + second)
    assert (len(log.groups[0]), log.frames) == (2, 2)
    log = log_of(first[:300] + second)
    assert (len(log.groups[0]), dict(log.left_out)) == (1, {"broken line": 1})


def test_a_list_that_was_cut_to_some_subcarriers_in_all_lines() -> None:
    text = lines(integers(20, 50)).replace(",100,0,", ",128,0,")
    [group] = log_of(text).groups
    assert (len(group), group.kind.subcarriers, group.kind.tones.numbers) == (20, 50, None)
    assert not log_of(lines(integers(1, 50)).replace(",100,0,", ",128,0,")).groups, "one line is no habit"


@given(st.lists(st.integers(-9999, 9999), min_size=2, max_size=40), st.sampled_from([", ", ",", " ", "  "]))
def test_numbers_are_those_that_python_reads(numbers: list[int], between: str) -> None:
    numbers = numbers[: len(numbers) // 2 * 2]
    text = (
        f"CSI_DATA,1,02:00:00:00:00:01,-30,11,-96,32,11,36,1000,47,0,0,0,[{between.join(map(str, numbers))}]"
    )
    [line] = parsed_lines(text.encode())
    assert line is not None
    assert line.numbers.tolist() == numbers


@pytest.mark.parametrize("text", ["1 2-3", "1 --2", "1 -", "1 2 3 123456", "1 - 2", "1 2x"])
def test_what_is_no_number_breaks_the_line(text: str) -> None:
    good = "CSI_DATA,1,02:00:00:00:00:01,-30,11,-96,32,11,36,1000,47,0,0,0,[1 2]\n"
    found = parsed_lines((good + good.replace("1 2]", text + "]") + good).encode())
    assert [line is None for line in found] == [False, True, False]
