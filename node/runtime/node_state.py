"""What the main process writes down of a run, and takes up again with `--resume`."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.folders import Folder, LocalFolder
from chachart.node.files.url_folders import folder_at
from chachart.node.runtime.plan import Plan
from chachart.node.runtime.state_files import NODE, Series, forget_unfinished, new_run, runs

log = logging.getLogger(__name__)

WRITE_EVERY_S = 1.0


class NodeState:
    """The folder of a run, and the main process's snapshots in it, which a thread of their own writes.

    Parameters
    ----------
    plan
        What the node does.
    private
        A folder that lasts as long as the node, for where nothing is to be resumed.
    current
        Gives the facts to write.

    Attributes
    ----------
    folder
        Where the workers' snapshots go.
    resumed
        The facts of the run that this one goes on with, or None.
    error
        Why the last snapshot could not be written, or None.

    Raises
    ------
    SetupError
        If the folder cannot be made, or what is there was made with another array or other methods' options.
    """

    def __init__(self, plan: Plan, private: Path, current: Callable[[], dict[str, Any]]) -> None:
        self.resumed: dict[str, Any] | None = None
        self.error: str | None = None
        self._current = current
        self._about = {"array": plan.array.as_dict(), "estimator": _options(plan)}
        self._series: Series | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="node state", daemon=True)
        directory = plan.state.directory
        if directory is None:
            self.folder: Folder = LocalFolder(private / "state")
            self.folder.make()
            return
        try:
            self.folder = self._folder(folder_at(directory), plan.state.resume)
        except OSError as error:
            raise SetupError(f"[state] directory {directory} cannot be used: {error.strerror}") from None
        self._series = Series(self.folder, NODE, durable=True)

    def start(self) -> None:
        """Write now and then from now on."""
        if self._series is not None:
            self._thread.start()

    def close(self) -> None:
        """Write one last time."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _folder(self, directory: Folder, resume: bool) -> Folder:
        before = runs(directory) if resume else []
        for folder in reversed(before):
            facts = Series(folder, NODE, durable=True).newest_facts()
            if facts is not None:
                self._check(facts, folder)
                forget_unfinished(folder)
                self.resumed = facts
                log.info("going on from %s", folder)
                return folder
        if resume:
            log.info("there is nothing in %s to resume from: a new run begins", directory)
        return new_run(directory)

    def _check(self, facts: dict[str, Any], folder: Folder) -> None:
        if differences := ArrayGeometry.from_dict(facts["array"]).mismatches(
            ArrayGeometry.from_dict(self._about["array"])
        ):
            what = f"another array: {'; '.join(differences)}"
        elif facts["estimator"] != self._about["estimator"]:
            names = sorted(k for k, v in self._about["estimator"].items() if facts["estimator"].get(k) != v)
            what = f"another [estimator]: {', '.join(names)}"
        else:
            return
        raise SetupError(f"{folder} was made with {what} (leave --resume out to begin anew)")

    def _run(self) -> None:
        while not self._stopping.wait(WRITE_EVERY_S):
            self._write()
        self._write()

    def _write(self) -> None:
        assert self._series is not None
        try:
            self._series.write({**self._about, **self._current()}, ())
            error = None
        except OSError as failed:
            error = f"{self.folder} cannot be written to: {failed.strerror}"
        if error != self.error:
            log.error("%s", error) if error else log.warning("%s is written again", self.folder)
        self.error = error


def _options(plan: Plan) -> dict[str, Any]:
    """What snapshots of UEs depend on, apart from the methods, which go on as they were."""
    options: dict[str, Any] = plan.estimator.model_dump(mode="json")
    return {
        name: value for name, value in options.items() if name not in ("theta", "rho", "max_ues", "path_list")
    }
