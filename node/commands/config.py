"""Print a commented sample configuration, made from the settings themselves.

chachart config > my.toml                 a whole configuration, every key at its default
chachart config source recording          one source's table, to paste
chachart config sink publisher            one sink's table, to paste
chachart config --table                   every setting as a Markdown table
"""

from __future__ import annotations

import argparse

from chachart.config import sample
from chachart.config.registry import available
from chachart.node.data.errors import SetupError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart config`."""
    parser.add_argument("kind", nargs="?", choices=["source", "sink"], help="print one source or sink only")
    parser.add_argument("name", nargs="?", help="which source or sink")
    parser.add_argument("--table", action="store_true", help="print every setting as a Markdown table")


def run(arguments: argparse.Namespace) -> int:
    """Print the sample.

    Raises
    ------
    SetupError
        If there is no such source or sink.
    """
    if arguments.table:
        print(sample.table())
    elif arguments.kind is None:
        print(sample.configuration())
    elif arguments.name is None:
        names = ", ".join(available(arguments.kind))
        raise SetupError(f"which {arguments.kind}? There are {names}")
    else:
        print(sample.component(arguments.kind, arguments.name))
    return 0
