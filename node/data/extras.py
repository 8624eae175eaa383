"""The libraries that chachart can do without: which extra brings each, and what to say where it lacks."""

from __future__ import annotations

from importlib.util import find_spec

from chachart.node.data.errors import SetupError

EXTRAS = {
    "serial": {"serial": "pyserial", "cobs": "cobs"},
    "can": {"can": "python-can", "isotp": "can-isotp"},
    "formats": {"h5py": "h5py", "google_crc32c": "google-crc32c"},
    "yaml": {"yaml": "pyyaml"},
    "patterns": {"quadriga_lib": "quadriga-lib"},
    "parquet": {"pyarrow": "pyarrow"},
    "plot": {"matplotlib": "matplotlib", "PIL": "pillow"},
    "bench": {"threadpoolctl": "threadpoolctl"},
    "pandas": {"pandas": "pandas"},
    "foxglove": {"foxglove": "foxglove-sdk"},
    "state": {"fsspec": "fsspec"},
    "ray": {"ray": "ray"},
    "mqtt": {"paho": "paho-mqtt"},
}
"""By extra of chachart: module and the package it comes in."""


def missing(extra: str) -> list[str]:
    """What to say of the libraries of an extra that are not installed; nothing if all are."""
    packages = [package for module, package in EXTRAS[extra].items() if find_spec(module) is None]
    if not packages:
        return []
    return [f'{" and ".join(packages)} not installed: pip install "chachart[{extra}]"']


def require(extra: str, who: str) -> None:
    """Make sure that the libraries of an extra are there.

    Parameters
    ----------
    extra
        One of `EXTRAS`.
    who
        What needs them, as the message begins: `chachart plot:`.

    Raises
    ------
    SetupError
        If they are not.
    """
    for problem in missing(extra):
        raise SetupError(f"{who} {problem}")
