"""`chachart device`: a simulated device in a process of its own, and a source that listens to it."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live_node import free_port
from source_contract import receive

from chachart.config.load import load
from chachart.config.registry import source_class
from chachart.node.commands.main import main

CHACHART = [sys.executable, "-m", "chachart.node.commands.main"]


@contextmanager
def device(*arguments: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A device that is there, and what it says to give to a source."""
    command = [*CHACHART, "device", *arguments, "--listen", "127.0.0.1:0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline(), process
        finally:
            process.kill()


@pytest.mark.parametrize("name", ["espargos", "oai"])
def test_a_source_listens_to_a_device_in_another_process(name: str) -> None:
    with device(name) as (told, process):
        where = dict(re.findall(r"(\w+)=(\S+)", told))
        changes = [f"source.{key}={value}" for key, value in where.items()]
        changes += ["source.loopback=false", *(["source.calibrate_s=0.2"] if name == "espargos" else [])]
        settings = load(Path(f"{name}-loopback.toml"), changes)
        assert settings.array is not None
        with source_class(name)(settings.source, settings.array.geometry()) as source:
            blocks = receive(source, 20)
        process.send_signal(signal.SIGINT)
        report = json.loads(process.communicate(timeout=20)[0])
        assert process.returncode == 0
    assert sum(len(block) for block in blocks) >= 20
    assert report["sent"] >= 20


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["toaster"], 'there is no device "toaster", only espargos, oai, krakensdr, wifi'),
        (["oai", "--config", "lab.toml"], 'a source "simulator", not "oai"'),
        (["oai", "--set", "source.loopback=false"], "[source] loopback: must be true, or a table"),
        (["oai", "--listen", "192.0.2.1:7"], "192.0.2.1:7 cannot be listened at"),
    ],
)
def test_mistakes_are_told(arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["device", *arguments]) == 78
    assert told in capsys.readouterr().err


def test_all_boards_of_a_hall_are_there() -> None:
    with device("espargos", "--config", "espargos-hall") as (first, process):
        assert process.stdout is not None
        told = [first, *(process.stdout.readline() for _ in range(3))]
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    numbers = [re.match(r"espargos of source\.(\d): boards=", line) for line in told]
    assert [number and number[1] for number in numbers] == ["0", "1", "2", "3"]


def test_a_tool_that_is_asked_answers_whoever_asks() -> None:
    """FeitCSI listens, and sends to whoever gave it a command."""
    numbers = [*range(-28, 0), *range(1, 29)]
    array = ["array.antennas=2", f"array.tones={numbers}", "source.tool=feitcsi"]
    command = [*CHACHART, "device", "wifi", "--listen", f"127.0.0.1:{free_port()}", "--json", "--set", *array]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            told = dict(re.findall(r"(\w+)=(\S+)", process.stdout.readline()))
            assert told["tool"] == "feitcsi"
            where = [f"source.{key}={told[key]}" for key in ("host", "port")]
            settings = load(Path("wifi-loopback.toml"), [*array, *where, "source.loopback=false"])
            assert settings.array is not None
            for _ in range(2):  # it goes on for the next who asks
                with source_class("wifi")(settings.source, settings.array.geometry()) as source:
                    assert sum(len(block) for block in receive(source, 20)) >= 20
        finally:
            process.kill()
