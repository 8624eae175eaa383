"""Print the shipped configurations, and commented samples made from the settings themselves.

chachart config list                      the shipped configurations and what each is for
chachart config show replay > my.toml     one of them, to change; `chachart-node --config replay` runs it
chachart config > my.toml                 a whole configuration, every key at its default
chachart config source recording          one source's table, to paste
chachart config sink publisher            one sink's table, to paste
chachart config --table                   every setting as a Markdown table
"""

from __future__ import annotations

import argparse

from chachart.config import sample, shipped
from chachart.config.registry import available
from chachart.node.data.errors import SetupError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart config`."""
    parser.add_argument("kind", nargs="?", choices=["list", "show", "source", "sink"], help="what to print")
    parser.add_argument("name", nargs="?", help="which configuration, source or sink")
    parser.add_argument("--table", action="store_true", help="print every setting as a Markdown table")


def run(arguments: argparse.Namespace) -> int:
    """Print the sample.

    Raises
    ------
    SetupError
        If there is no such configuration, source or sink.
    """
    if arguments.table:
        print(sample.table())
    elif arguments.kind is None:
        print(sample.configuration())
    elif arguments.kind == "list":
        for name in shipped.names():
            print(f"{name:<22}{shipped.purpose(name)}")
    elif arguments.kind == "show":
        if arguments.name is None:
            raise SetupError(f"which configuration? There are {', '.join(shipped.names())}")
        print(shipped.text_file(arguments.name).read_text("utf-8"), end="")
    elif arguments.name is None:
        names = ", ".join(available(arguments.kind))
        raise SetupError(f"which {arguments.kind}? There are {names}")
    else:
        print(sample.component(arguments.kind, arguments.name))
    return 0
