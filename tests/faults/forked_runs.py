"""Processes of planrunner without the seconds that importing takes: `python forked_runs.py` has everything imported and forks one for each
line of JSON on its standard input, `{"arguments", "folder", "told", "environment"}`; it answers with process numbers and, as they end,
exit codes.

What is forked is a process like any other: it has its own signals, and can be killed.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

IMPORTED = (
    "pandas",
    "pyarrow.parquet",
    "rich.console",
    "serial",
    "planrunner.bench.watchdog",
    "planrunner.cli.resume",
    "planrunner.cli.run",
    "planrunner.reporting.terminal",
    "planrunner.tasks.estimate",
    "planrunner.tasks.run",
)


@dataclass
class Run:
    """A forked process. told: what it writes to standard output and standard error."""

    forks: Forks
    pid: int
    told: Path
    begun: float

    @property
    def code(self) -> int | None:
        """Its exit code, negative for a signal; None while it goes on."""
        self.forks.listen(0.0)
        return self.forks.codes.get(self.pid)

    def wait(self, patience: float) -> int:
        """Its exit code. Raises `AssertionError` for one that hangs, which is ended."""
        end = time.monotonic() + patience
        while (code := self.code) is None:
            if time.monotonic() > end:
                os.kill(self.pid, signal.SIGKILL)
                raise AssertionError(f"it hangs: still there after {patience:g} s; it said: {self.said}")
            self.forks.listen(0.1)
        return code

    @property
    def said(self) -> str:
        return self.told.read_text(encoding="utf-8")

    def send(self, number: int) -> None:
        if self.code is None:
            os.kill(self.pid, number)


class Forks:
    """The process that forks."""

    def __init__(self, environment: dict[str, str]):
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([sys.executable, __file__], env=environment, stdin=pipe, stdout=pipe, bufsize=0)
        assert self.process.stdout is not None
        self.heard = selectors.DefaultSelector()  # `select` itself knows descriptors below 1024 only
        self.heard.register(self.process.stdout, selectors.EVENT_READ)
        self.codes: dict[int, int] = {}
        self.begun: list[int] = []
        self.rest = b""

    def start(self, arguments: list[str], folder: Path, told: Path, environment: Mapping[str, str]) -> Run:
        request = {
            "arguments": arguments,
            "folder": str(folder),
            "told": str(told),
            "environment": {"PLANRUNNER_LOCKS": str(folder / "locks"), **environment},
        }
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(request).encode() + b"\n")
        while not self.begun:
            self.listen(1.0)
        return Run(self, self.begun.pop(), told, time.monotonic())

    def listen(self, patience: float) -> None:
        assert self.process.stdout is not None
        while self.heard.select(patience):
            data = os.read(self.process.stdout.fileno(), 65536)
            assert data, "the process that forks has ended"
            *lines, self.rest = (self.rest + data).split(b"\n")
            for line in lines:
                told: dict[str, Any] = json.loads(line)
                if "code" in told:
                    self.codes[told["pid"]] = told["code"]
                else:
                    self.begun.append(told["pid"])
            if self.begun:
                return

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.heard.close()
        self.process.stdin.close()
        self.process.wait(60)
        self.process.stdout.close()


def _made_ready(folder: Path) -> None:
    """Import and compile what a run needs the first time."""
    from planrunner.bench.model import driver_of, read_bench
    from planrunner.instruments.wire import links
    from planrunner.instruments.wire.framing import Framer, Piece

    for module in IMPORTED:
        import_module(module)
    links._manager()
    bench, _, _ = read_bench(str(folder / "bench.yaml"))
    gyro = bench.instruments["gyro"]
    driver: Any = driver_of(gyro)
    decoder = driver.decoder_of(gyro.parameters)
    decoder.decode(Framer(decoder.framing).push([Piece(0.0, bytes(decoder.framing.longest))]))


def _serve() -> None:
    rest, listening, ready = b"", True, False
    running: set[int] = set()
    asked_at = selectors.SelectSelector()  # has no descriptor that those who are forked would get
    asked_at.register(0, selectors.EVENT_READ)
    while listening or running:
        if listening and asked_at.select(0.02):
            data = os.read(0, 65536)
            listening = bool(data)
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                asked = json.loads(line)
                if not ready:
                    _made_ready(Path(asked["folder"]))
                    ready = True
                pid = os.fork() or _become(asked)
                running.add(pid)
                print(json.dumps({"pid": pid}), flush=True)
        elif not listening:
            time.sleep(0.02)
        for pid in list(running):
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                running.discard(pid)
                print(json.dumps({"pid": pid, "code": os.waitstatus_to_exitcode(status)}), flush=True)


def _become(asked: dict[str, Any]) -> int:
    """Be a planrunner process to the end."""
    from broken_computer import break_with

    from planrunner.cli import main

    os.chdir(asked["folder"])
    os.environ.update(asked["environment"])
    tempfile.tempdir = None  # found anew in this environment
    break_with(Path("."))
    file = os.open(asked["told"], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number, target in ((nothing, 0), (file, 1), (file, 2)):
        os.dup2(number, target)
    code = 70
    try:
        code = main(asked["arguments"])
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve()
