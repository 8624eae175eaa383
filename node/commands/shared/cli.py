"""What every command shares: how mistakes are told, progress on a terminal, files that appear whole."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

from chachart.node.data.errors import EX_CONFIG, SetupError

EX_INTERRUPTED = 130
EX_BROKEN_PIPE = 141


class Parser(argparse.ArgumentParser):
    """A parser whose usage is one line: what must be given; `--help` lists the rest."""

    def format_usage(self) -> str:
        """The line."""
        self._shorten()
        return super().format_usage()

    def format_help(self) -> str:
        """The line, and everything there is."""
        self._shorten()
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in a line, and end with status 2."""
        self.exit(2, f"{self.prog}: {message}; `{self.prog} --help` says more\n")

    def _shorten(self) -> None:
        formatter = self.formatter_class(prog=self.prog)
        needed = [action for action in self._actions if not action.option_strings or action.required]
        formatter.add_usage(None, needed, [], prefix="")
        words = " ".join(formatter.format_help().split()).removeprefix(self.prog).replace("%", "%%")
        self.usage = f"%(prog)s [OPTIONS]{words}"


def add_key_options(parser: argparse.ArgumentParser) -> None:
    """`--key` and `--server-key`, for nodes that want one."""
    parser.add_argument("--key", type=Path, metavar="FILE", help="your NAME.key_secret, for a node with keys")
    parser.add_argument("--server-key", type=Path, metavar="FILE", help="that node's node.key")


def completed_words() -> list[str] | None:
    """The words before the one that a shell wants completed; None where no shell asks."""
    line = os.environ.get("COMP_LINE") if "_ARGCOMPLETE" in os.environ else None
    return None if line is None else line[: int(os.environ.get("COMP_POINT", len(line)))].split()[1:]


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer a shell that wants a word completed, if one does and argcomplete is installed."""
    if completed_words() is not None and find_spec("argcomplete") is not None:
        import argcomplete

        argcomplete.autocomplete(parser)


def guarded(program: str, run: Callable[[], int]) -> int:
    """The exit status of `run`, with what a user can cause told in one line each instead of a traceback.

    A `SetupError` goes to stderr and gives `EX_CONFIG`; Ctrl-C and a reader that has gone away end quietly
    with the status that a shell gives them.
    """
    try:
        status = run()
        sys.stdout.flush()
    except SetupError as error:
        for line in str(error).splitlines():
            print(f"{program}: {line}", file=sys.stderr)
        return EX_CONFIG
    except KeyboardInterrupt:
        return EX_INTERRUPTED
    except BrokenPipeError:
        # The interpreter flushes stdout once more on its way out; give it somewhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EX_BROKEN_PIPE
    return status


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A function to tell of each so many steps done; draws a bar where stderr is a terminal."""
    if not sys.stderr.isatty():
        yield lambda steps: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda steps: bar.advance(task, steps)


def check_writable(path: Path, force: bool, source: Path | None = None) -> None:
    """Tell early that a file cannot be written.

    Raises
    ------
    SetupError
        If its folder is not there, or it exists and must not be replaced: without `force` or, where it is
        the `source` that the command reads, at all.
    """
    if not path.parent.is_dir():
        raise SetupError(f"{path} cannot be written: there is no such folder")
    if path.exists() and not force:
        raise SetupError(f"{path} exists already; --force replaces it")
    if source is not None and path.exists() and source.exists() and path.samefile(source):
        raise SetupError(f"{path} is the file that is read; it cannot be the one that is written as well")


FIGURE_FORMATS = (".png", ".svg", ".pdf")
"""What figures can be."""


def check_figure(path: Path) -> None:
    """Tell early that a figure cannot be written; one that is there is replaced.

    Raises
    ------
    SetupError
        If its name ends in something else than `FIGURE_FORMATS`, or its folder is not there.
    """
    if path.suffix.lower() not in FIGURE_FORMATS:
        raise SetupError(f"{path} must end in one of {', '.join(FIGURE_FORMATS)}")
    check_writable(path, force=True)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A name to write to beside `path`; it takes that name when all went well, and goes away otherwise.

    Raises
    ------
    SetupError
        If the disk says no.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror}") from None
    finally:
        part.unlink(missing_ok=True)
