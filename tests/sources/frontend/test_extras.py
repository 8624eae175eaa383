"""What happens where the libraries of the extras are not installed."""

import subprocess
import sys

import pytest

PROGRAM = """
import sys
sys.modules.update(dict.fromkeys({missing!r}))
from chachart.config.registry import source_class
from chachart.config.settings import ArraySettings
from chachart.node.data.errors import SetupError
from chachart.node.commands.main import main
cls = source_class({name!r})
settings = cls.Settings.model_validate({{"type": {name!r}}})
print(*cls.problems(settings))
try:
    cls(settings, ArraySettings().geometry()).open()
except SetupError as error:
    print(error)
print(main(["frontend", *{arguments!r}]))
"""


@pytest.mark.parametrize(
    ("name", "missing", "arguments", "hint"),
    [
        (
            "serial",
            ["serial", "cobs"],
            ["--serial", "pty"],
            'pyserial and cobs not installed: pip install "chachart[serial]"',
        ),
        ("can", ["isotp"], ["--can", "virtual:x"], 'can-isotp not installed: pip install "chachart[can]"'),
        ("can_log", ["can"], ["--can", "virtual:x"], 'python-can not installed: pip install "chachart[can]"'),
    ],
)
def test_a_missing_library_is_named_with_its_extra(name, missing, arguments, hint):
    program = PROGRAM.format(name=name, missing=missing, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    problem, refused, status = done.stdout.splitlines()
    assert problem == hint
    assert refused == f"[source] {hint}"
    assert status == "78"
    assert hint in done.stderr
