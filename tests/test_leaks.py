"""The fixture that every test runs under: it must see what a test leaves behind."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

TESTS = """
import socket, subprocess, threading, zmq

kept = []

def test_socket():
    kept.append(socket.socket())

def test_thread():
    kept.append(threading.Thread(target=threading.Event().wait, daemon=True))
    kept[-1].start()

def test_process():
    kept.append(subprocess.Popen(["sleep", "10"]))

def test_zmq():
    kept.append(zmq.Context().socket(zmq.PULL))
    kept[-1].bind("tcp://127.0.0.1:0")

def test_tidy():
    socket.socket().close()
    subprocess.run(["true"])
"""


def test_what_a_test_leaves_behind_fails_it(tmp_path: Path) -> None:
    fixture = Path(__file__).with_name("conftest.py").read_text()
    (tmp_path / "conftest.py").write_text(fixture.replace("GRACE_S = 5.0", "GRACE_S = 0.1"))
    (tmp_path / "test_it.py").write_text(TESTS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    failed = re.findall(r"^ERROR test_it.py::test_(\w+) - AssertionError: left behind", ended.stdout, re.M)
    assert failed == ["socket", "thread", "process", "zmq"], ended.stdout
    assert "5 passed, 4 errors" in ended.stdout
