"""Make and list the CURVE keys with which programs on other machines reach a node.

chachart keys new node                     the node's own pair; `keys = "keys"` in [security] uses it
chachart keys new ana                      a pair for somebody: ana.key_secret to keep, ana.key to hand in
chachart keys allow ana.key --may read     let Ana subscribe and ask (steer: also steer, send: send CSI)
chachart keys list                         who may do what

Somebody with a key connects with `--key ana.key_secret --server-key node.key`; take a file out of its folder
and whoever it was gets in no more.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from chachart.node.data.errors import SetupError
from chachart.node.net.keys import NODE, RIGHTS, allow, new_pair

FOLDER = Path("keys")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart keys`."""
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    new = actions.add_parser("new", help="make a pair of keys")
    new.add_argument("name", metavar="NAME", help=f'whose; "{NODE}" is the node itself')
    new.add_argument(
        "--folder", type=Path, metavar="DIR", help=f"where to ({FOLDER} for the node, else here)"
    )
    new.set_defaults(action=_new)
    allowed = actions.add_parser("allow", help="let whoever has the secret of a public key connect")
    allowed.add_argument("file", type=Path, metavar="NAME.key", help="the public key")
    allowed.add_argument("--may", choices=RIGHTS, required=True, help="what they may do")
    allowed.add_argument("--folder", type=Path, default=FOLDER, metavar="DIR", help=f"the keys ({FOLDER})")
    allowed.set_defaults(action=_allow)
    listed = actions.add_parser("list", help="who may do what")
    listed.add_argument("--folder", type=Path, default=FOLDER, metavar="DIR", help=f"the keys ({FOLDER})")
    listed.set_defaults(action=_list)


def run(arguments: argparse.Namespace) -> int:
    """Do it.

    Raises
    ------
    SetupError
        If a file cannot be read or written, or is there already.
    """
    arguments.action(arguments)
    return 0


def _new(arguments: argparse.Namespace) -> None:
    folder = arguments.folder or (FOLDER if arguments.name == NODE else Path())
    public, secret = new_pair(folder, arguments.name)
    print(f"{secret}: keep it to yourself")
    print(f"{public}: hand it to {'everybody who connects' if arguments.name == NODE else 'the node'}")


def _allow(arguments: argparse.Namespace) -> None:
    print(f"{allow(arguments.folder, arguments.file, arguments.may)}: may {arguments.may}")


def _list(arguments: argparse.Namespace) -> None:
    if not arguments.folder.is_dir():
        raise SetupError(f"{arguments.folder} is no folder of keys; `chachart keys new {NODE}` makes one")
    for right in RIGHTS:
        names = sorted(path.stem for path in (arguments.folder / right).glob("*.key"))
        print(f"{right:<6} {' '.join(names) or '-'}")
