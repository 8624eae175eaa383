# PYTHON_ARGCOMPLETE_OK
"""`chachart`: the tools around a node, one module a command, imported when called."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module

from chachart.node.commands.shared.cli import Parser, complete, completed_words, guarded
from chachart.node.data.version import build

COMMANDS = {
    "array": "say and draw what an array looks like and what it can see",
    "bench": "measure how fast this machine runs chachart",
    "calibrate": "find an array's calibration, and swapped cables, from a recording",
    "config": "print a commented sample configuration",
    "ctl": "ask and steer a running node",
    "device": "be a live device (espargos, oai, krakensdr, wifi), simulated, for a node to listen to",
    "evaluate": "chart a recording and say how good the chart is",
    "export": "turn a recording or a chart log into a file for other tools",
    "frontend": "be an array front-end on a serial line or a CAN bus, with faults on request",
    "import": "turn a capture of another tool into a recording",
    "keys": "make and list the keys with which other machines reach a node",
    "info": "show what a recording holds",
    "plot": "draw charts, spectra, quality, errors and calibrations for papers",
    "reproduce": "reproduce the published tables and figures, as one HTML report",
    "train": "fit what estimators say of their errors to the simulator's channels",
    "watch": "watch a node's chart in the terminal",
}
"""Each command and what it does. Its module here, `<name>.py` or `<name>_.py` for a word that Python has
taken, has `add_arguments(parser)` and `run(arguments) -> exit status`."""

_TAKEN = {"import"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run `chachart` with `argv` (the command line if None) and return its exit status."""
    argv = sys.argv[1:] if argv is None else argv
    parser = Parser(
        prog="chachart", description="Tools for channel charting. The node itself is chachart-node."
    )
    parser.add_argument("--version", action="version", version=f"chachart {build()}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    completing = completed_words()
    called = next((word for word in completing or argv if not word.startswith("-")), None)
    if completing is None and called is not None and called not in COMMANDS:
        close = get_close_matches(called, COMMANDS, n=1)
        hint = f'; did you mean "{close[0]}"?' if close else ""
        parser.error(f'there is no command "{called}", only {", ".join(COMMANDS)}{hint}')
    for name, purpose in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=purpose)
        if name == called:
            module = import_module(f"chachart.node.commands.{name}{'_' if name in _TAKEN else ''}")
            subparser.description = module.__doc__
            subparser.formatter_class = argparse.RawDescriptionHelpFormatter
            module.add_arguments(subparser)
            subparser.set_defaults(run=module.run)
    complete(parser)
    arguments = parser.parse_args(argv)
    return guarded(f"chachart {called}", lambda: arguments.run(arguments))


if __name__ == "__main__":
    raise SystemExit(main())
