"""What every folder promises, on this machine and behind a URL."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from socket import socket
from typing import IO

import fsspec
import numpy as np
import pytest

from chachart.node.data.errors import SetupError
from chachart.node.files.folders import Folder, FolderError, LocalFolder
from chachart.node.files.snapshots import unpack
from chachart.node.files.url_folders import folder_at
from chachart.node.runtime.state_files import counts, forget_unfinished, new_run, runs, worker_series

ROWS = {"0/ue[]": np.arange(5, dtype=np.uint64), "0/r[]": np.ones((5, 2, 2), np.complex64)}


@pytest.fixture(params=["path", "file", "memory", "s3"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Folder]:
    if request.param == "s3":
        yield folder_at(f"{request.getfixturevalue('bucket')}/a/state")
        return
    memory = f"memory://{request.node.name}"
    yield folder_at({"path": str(tmp_path), "file": tmp_path.as_uri(), "memory": memory}[request.param])
    fsspec.filesystem("memory").store.clear()


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A bucket of a server that speaks S3, where it and the driver happen to be installed."""
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server = pytest.importorskip("moto.server", reason="moto with its server is not installed")
    running = server.ThreadedMotoServer(port=0)
    running.start()
    host, port = running.get_host_and_port()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    fsspec.filesystem("s3").mkdir("bucket")
    yield "s3://bucket"
    running.stop()
    fsspec.filesystem("s3").clear_instance_cache()


def written(folder: Folder, name: str) -> bytes:
    with folder.open(name) as file:
        return file.read()


def test_a_file_is_there_when_all_of_it_is(folder: Folder) -> None:
    folder.make()
    folder.write("a", lambda file: _write(file, b"one"), durable=True)

    def broken(file: IO[bytes]) -> None:
        file.write(b"two")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        folder.write("a", broken, durable=False)
    folder.write("a", lambda file: _write(file, b"three"), durable=False, wanted=lambda: False)
    assert written(folder, "a") == b"one"
    assert list(folder.files()) == ["a"]
    assert abs(folder.files()["a"] - time.time()) < 24 * 3600
    folder.write("a", lambda file: _write(file, b"four"), durable=False)
    assert written(folder, "a") == b"four"
    folder.remove("a")
    assert not folder.files()
    with pytest.raises(FileNotFoundError), folder.open("a"):
        pass


def _write(file: IO[bytes], data: bytes) -> None:
    file.write(data)


def test_snapshots_are_numbered_and_the_newest_whole_one_is_taken(folder: Folder) -> None:
    run = new_run(folder)
    series = worker_series(run, 0, 2, durable=True)
    for seq in range(4):
        series.write({"seq": seq}, ROWS.items())
    assert [facts["seq"] for _, facts, _ in series.newest()] == [3, 2]
    name = sorted(name for name in run.files() if name.endswith(".snapshot"))[-1]
    whole = written(run, name)
    run.write(name, lambda file: _write(file, whole[: len(whole) // 2]), durable=False)
    [(_, facts, arrays)] = list(series.newest())
    assert facts["seq"] == 2
    np.testing.assert_array_equal(arrays["0/ue[]"], ROWS["0/ue[]"])
    worker_series(run, 1, 2, durable=True).write({"seq": 0}, ROWS.items())
    assert counts(run, 0, 3) == [2]


def test_the_newest_snapshots_are_taken_however_many_workers_wrote_them(folder: Folder) -> None:
    run = new_run(folder)

    def write(shard: int, count: int) -> None:
        worker_series(run, shard, count, durable=True).write({}, ROWS.items())

    def all_write(count: int) -> None:
        for shard in range(count):
            write(shard, count)

    all_write(2)
    write(0, 3)
    assert counts(run, 1, 2) == [2], "the others of three wrote none"
    assert counts(run, 0, 3) == [3, 2]
    assert counts(run, 1, 3) == [2]
    all_write(3)
    assert counts(run, 1, 2) == [3, 2]
    write(0, 2)
    assert counts(run, 0, 2) == [2, 3]
    assert counts(run, 1, 2) == [3, 2], "its own is from before there were three"
    all_write(2)
    write(0, 3)
    assert counts(run, 1, 2) == [2, 3], "two of three are from before there were two again"


def test_the_last_run_before_a_new_one_is_kept(folder: Folder) -> None:
    first, second = new_run(folder), new_run(folder)
    worker_series(first, 0, 1, durable=True).write({}, ROWS.items())
    third = new_run(folder)
    assert [run.name for run in runs(folder)] == [second.name, third.name]
    assert first.name not in (second.name, third.name)


def test_what_a_dead_one_was_writing_never_appears(folder: Folder) -> None:
    run = new_run(folder)
    series = worker_series(run, 0, 1, durable=False)

    def succeeded() -> bool:
        forget_unfinished(run)
        return True

    with pytest.raises(FileNotFoundError):
        series.write({}, ROWS.items(), succeeded)
    assert not list(series.newest())
    assert list(run.files()) == ["started"]


def test_the_path_of_a_folder_is_taken_as_it_is() -> None:
    assert str(folder_at("relative/state")) == "relative/state"
    assert str(folder_at("file:///var/lib/a%20b")) == "/var/lib/a b"
    colon = folder_at("./a:b")
    assert isinstance(colon, LocalFolder)
    assert str(folder_at(str(colon))) == "./a:b"


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("s3:bucket/x", "s3://bucket/x"),
        ("file:relative", "file:///var/lib/chachart"),
        ("file://server/share", "folder of this machine"),
        ("nothing://x/y", "fsspec knows no nothing: file system"),
        ("abfs://x/y", "adlfs"),
    ],
)
def test_a_url_that_leads_nowhere_is_told(url: str, words: str) -> None:
    with pytest.raises(SetupError, match=words) as error:
        folder_at(url)
    assert "\n" not in str(error.value)


def test_problems_are_told_before_anything_starts(tmp_path: Path) -> None:
    assert folder_at(tmp_path).problems() == folder_at(str(tmp_path / "new")).problems() == []
    assert "not a folder" in folder_at(str(tmp_path / "a" / "b")).problems()[0]
    assert "each process alone" in folder_at("memory://state").problems()[0]
    url = f"local://{tmp_path}"
    assert folder_at(url).problems() == folder_at(f"{url}/new").problems() == []
    assert "is there" in folder_at(f"{url}/a/b").problems()[0]
    assert not list(tmp_path.iterdir())
    if os.geteuid():
        tmp_path.chmod(0o500)
        assert "Permission denied" in folder_at(url).problems()[0]


def test_what_is_out_of_reach_is_no_empty_folder() -> None:
    """Only an answer can say that nothing is there."""
    with socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        folder = folder_at(f"ftp://127.0.0.1:{taken.getsockname()[1]}/state")
        assert "refused" in folder.problems()[0]
        for look in (folder.is_there, folder.files, folder.folders, partial(unpack, folder, "a")):
            with pytest.raises(FolderError, match="refused"):
                look()


def test_problems_of_a_bucket(bucket: str) -> None:
    assert folder_at(f"{bucket}/new").problems() == []
    assert "is there" in folder_at("s3://missing/new").problems()[0]
