"""Snapshots of estimators: pieces and later ones joined, several merged, some UEs picked.

Beside rows and shared numbers (see `state`) a snapshot of an estimator has `method` (theta, rho), `known`,
every UE that it had, and `rejected.reasons` with `rejected.counts`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.state import ROWS, Snapshot

UE = "table.ue" + ROWS
SEEN = "table.last_seen" + ROWS
WAITING = "waiting."
"""What frames that wait for others begin with: `waiting.<array>.<field>`, a row a frame."""


def joined(snapshots: Sequence[Snapshot]) -> Snapshot:
    """What one estimator had, from its snapshots in the order of their making: whole ones, pieces, and those
    of what was touched since.

    A UE has its newest row, unless the last snapshot no longer knows it; what was there before a change of
    method is dropped. Everything that is no row is the last one's.

    Raises
    ------
    ValueError
        If there is none, or one is incomplete.
    """
    if not snapshots:
        raise ValueError("there must be at least one snapshot")
    for snapshot in snapshots:
        _check(snapshot)
    last = snapshots[-1]
    alike = [s for s in snapshots if np.array_equal(s["method"], last["method"]) and s.keys() == last.keys()]
    rows = _stacked(alike)
    newest = len(rows[UE]) - 1 - np.unique(rows[UE][::-1], return_index=True)[1]
    kept = np.sort(newest[np.isin(rows[UE][newest], last["known"])])
    return last | {name: values[kept] for name, values in rows.items()}


def merged(
    snapshots: Sequence[Snapshot], keep: Callable[[NDArray[np.uint64]], NDArray[np.bool_]] | None = None
) -> Snapshot:
    """The UEs of several estimators in one, for another number of workers: those that `keep` says, or all.

    Shared numbers are added up. Where several estimators are made from the same ones, each gets all of them:
    each then knows as much of the channel as all did.

    Raises
    ------
    ValueError
        If there is none, one is incomplete, or their methods differ.
    """
    if not snapshots:
        raise ValueError("there must be at least one snapshot")
    for snapshot in snapshots:
        _check(snapshot)
        if not np.array_equal(snapshot["method"], snapshots[0]["method"]):
            raise ValueError("snapshots of different methods cannot be merged")
    rows = _stacked(snapshots)
    by_age = np.argsort(rows[SEEN], kind="stable")
    newest = by_age[len(by_age) - 1 - np.unique(rows[UE][by_age][::-1], return_index=True)[1]]
    chosen = np.sort(newest)
    known = np.unique(np.concatenate([s["known"] for s in snapshots]))
    if keep is not None:
        chosen = chosen[keep(rows[UE][chosen])]
        known = known[keep(known)]
    counts: dict[str, int] = {}
    for snapshot in snapshots:
        for reason, n in zip(snapshot["rejected.reasons"], snapshot["rejected.counts"], strict=True):
            counts[str(reason)] = counts.get(str(reason), 0) + int(n)
    shared = [name for name in snapshots[0] if name.startswith("locator.") and name not in rows]
    return {
        **{name: values[chosen] for name, values in rows.items()},
        **{name: np.asarray(sum(s[name] for s in snapshots)) for name in shared},
        **counted(counts),
        **_waiting(snapshots, keep),
        "method": snapshots[0]["method"],
        "known": known,
    }


def _waiting(
    snapshots: Sequence[Snapshot], keep: Callable[[NDArray[np.uint64]], NDArray[np.bool_]] | None
) -> Snapshot:
    """The frames that waited, of the UEs that `keep` says, and when arrays were heard last."""
    found: Snapshot = {}
    for name in (name for name in snapshots[0] if name.startswith(WAITING)):
        array, dot, _ = name.removeprefix(WAITING).partition(".")
        parts = [s[name] for s in snapshots if name in s]
        if not dot:
            found[name] = np.max([part for part in parts if len(part)] or [np.zeros(0, np.int64)], axis=0)
            continue
        ues = [s[f"{WAITING}{array}.ue"] for s in snapshots if name in s]
        which = [np.ones(len(ue), np.bool_) if keep is None else keep(ue) for ue in ues]
        found[name] = np.concatenate([part[mine] for part, mine in zip(parts, which, strict=True)])
    return found


def counted(counts: dict[str, int]) -> Snapshot:
    """Counts by reason as arrays."""
    return {
        "rejected.reasons": np.array(list(counts), np.str_),
        "rejected.counts": np.array(list(counts.values()), np.int64),
    }


def _stacked(snapshots: Sequence[Snapshot]) -> Snapshot:
    names = [name for name in snapshots[0] if name.endswith(ROWS)]
    try:
        return {name: np.concatenate([s[name] for s in snapshots]) for name in names}
    except (KeyError, ValueError) as error:
        raise ValueError(f"the snapshots do not go together: {error}") from None


def _check(snapshot: Snapshot) -> None:
    needed = ("method", "known", UE, SEEN, "rejected.reasons", "rejected.counts")
    if missing := [name for name in needed if name not in snapshot]:
        raise ValueError(f"{', '.join(missing)} is not in the snapshot")
