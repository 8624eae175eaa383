from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from chachart.node.commands.main import COMMANDS, main
from chachart.node.commands.shared.cli import guarded
from chachart.node.data.errors import SetupError

CHACHART = [sys.executable, "-m", "chachart.node.commands.main"]


def usage_error(*argv: str) -> int:
    with pytest.raises(SystemExit) as caught:
        main(argv)
    return int(str(caught.value.code))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert usage_error(command, "--help") == 0
    assert f"usage: chachart {command}" in capsys.readouterr().out


def test_help_imports_no_command() -> None:
    code = (
        "import sys; from chachart.node.commands.main import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "assert not {'numpy', 'pydantic', 'scipy', 'zmq', 'rich'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_usage_errors_exit_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert usage_error() == 2
    assert usage_error("confg") == 2
    assert 'no command "confg"' in (said := capsys.readouterr().err)
    assert 'did you mean "config"?' in said
    assert usage_error("config", "--nonsense") == 2


def test_a_usage_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert usage_error("import", "a.npz") == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("chachart import: the following arguments are required: OUT.mcap")
    assert usage_error("import", "--help") == 0
    usage = capsys.readouterr().out.partition("\n\n")[0]
    assert usage.startswith("usage: chachart import [OPTIONS] IN")
    assert len(usage.splitlines()) == 1


def completed(line: str) -> list[str]:
    """What a shell that completes `line` is offered."""
    environment = {**os.environ, "_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    read_end, write_end = os.pipe()
    script = f"exec 8>&{write_end}; exec {sys.executable} -m chachart.node.commands.main"
    done = subprocess.Popen(["bash", "-c", script], env=environment, pass_fds=[write_end])
    os.close(write_end)
    with os.fdopen(read_end) as offered:
        words = offered.read().replace("\x0b", " ").split()
    done.wait(20)
    return words


def test_shells_complete_commands_and_options() -> None:
    pytest.importorskip("argcomplete")
    assert completed("chachart ev") == ["evaluate"]
    assert completed("chachart evaluate --the") == ["--theta"]


def test_mistakes_are_one_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    def wrong() -> int:
        raise SetupError("one thing\nanother")

    assert guarded("chachart", wrong) == 78
    assert capsys.readouterr().err == "chachart: one thing\nchachart: another\n"


def test_ctrl_c_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted() -> int:
        os.kill(os.getpid(), signal.SIGINT)
        return 0

    assert guarded("chachart", interrupted) == 130
    assert capsys.readouterr().err == ""


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    done = subprocess.run(
        [*CHACHART, "config", "source", "simulator"], stdout=write_end, stderr=subprocess.PIPE, check=False
    )
    os.close(write_end)
    assert done.returncode == 141
    assert done.stderr == b""
