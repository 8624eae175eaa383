import json

import pytest
from front_ends import front_end, report

from chachart.node.commands.main import main


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--serial", "/nowhere/port"], 'serial port "/nowhere/port" cannot be opened'),
        (["--serial", "pty:/nowhere/port"], "cannot make the link /nowhere/port"),
        (["--can", "virtual"], "must be INTERFACE:CHANNEL"),
        (["--can", "no_such:x"], 'of interface "no_such" cannot be opened'),
        (["--can", "virtual:x", "--id", "0x10", "--reply-id", "0x10"], "used more than once"),
        (["--can", "virtual:x", "--option", "port"], "must be KEY=VALUE"),
        (["--serial", "pty", "--drop", "2"], "--drop"),
        (["--serial", "pty", "--format", "int12"], "--format"),
        (["missing.mcap", "--serial", "pty"], "missing.mcap"),
        (["missing.mcap", "--serial", "pty", "--speed", "-1"], "--speed: "),
        (["--can", "virtual:x", "--id", "0x20000000"], "--id: "),
        (["--can", ":x"], "--can: "),
        (["--serial", "pty", "--drop", "nan"], "--drop: "),
        (["--serial", "pty", "--set", "source.uess=3"], "uess"),
    ],
)
def test_mistakes_end_in_one_line(capsys, arguments, said):
    assert main(["frontend", *arguments]) == 78
    error = capsys.readouterr().err
    assert said in error
    assert len(error.splitlines()) == 1
    assert "Traceback" not in error


def test_nobody_listening_costs_nothing_and_it_ends_when_told():
    with front_end("--serial", "pty", frames=100) as device:
        device.terminate()
        counts = report(device)
    assert set(counts.values()) == {0}


def test_help_describes_every_fault(capsys):
    with pytest.raises(SystemExit):
        main(["frontend", "--help"])
    text = capsys.readouterr().out
    for word in ("--corrupt", "--drop", "--reorder", "--unplug-every-s", "Fraction of the frames"):
        assert word in text
    assert json.dumps(text)
