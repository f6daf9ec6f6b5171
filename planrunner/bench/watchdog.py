"""Starts and feeds the watchdog, a separate process that makes the bench safe if planrunner can no longer do so.

The watchdog is started before the first instrument is connected. The watchdog receives the names of the instruments that the run
controls, and a heartbeat about every second. The watchdog ends when the run reports that the bench is safe. If the connection ends
in any other way, planrunner has crashed, was killed or could not make the bench safe; the watchdog then acts
(`planrunner.bench.watchdog_process`). If the heartbeat stops for longer than the bench allows, the watchdog ends planrunner and
then acts. The watchdog acts only on the instruments that the run controlled.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Collection
from pathlib import Path
from typing import IO

from planrunner.instruments.interfaces import InstrumentError

STARTING = 60.0
LEAVING = 5.0
ENDING = 120.0
"""Time limits for the watchdog, s: to start, to end on request, and to make a bench safe if planrunner could not do so."""
EVERY = 1.0
"""Time between two heartbeats, s."""
_GONE = (
    "the watchdog process has ended, or has made the bench safe after a time without a sign of life: check whether the computer hung or "
    "another user ended the process, then resume the run"
)


class Watchdog:
    """A running watchdog process. Raises `InstrumentError` if it cannot be started."""

    def __init__(self, bench_file: bytes, shown: str, data_root: Path | None, silence: float):
        self._told = 0.0
        self._process = _start()
        told = {
            "bench": base64.b64encode(bench_file).decode(),
            "shown": shown,
            "data_root": None if data_root is None else str(data_root.absolute()),
            "silence": silence,
            "parent": os.getpid(),
        }
        try:
            self._tell(json.dumps(told))
            answer = _first_line(self._process, STARTING)
        except OSError as error:
            answer = error.strerror or "its pipe is broken"
        if answer != "ready":
            self._process.kill()
            self._part(LEAVING)
            raise InstrumentError(
                f"the watchdog, which makes the bench safe if planrunner is killed, does not start: {answer}"
            )
        with contextlib.suppress(OSError, AttributeError):  # a watchdog that hangs must not block planrunner
            os.set_blocking(self._stdin.fileno(), False)

    @property
    def pid(self) -> int:
        return self._process.pid

    def sign_of_life(self) -> None:
        """Informs the watchdog that planrunner is at work. The method may be called often, at low cost. Raises `InstrumentError` if
        the watchdog has ended."""
        now = time.monotonic()
        if now - self._told < EVERY:
            return
        self._told = now
        try:
            self._tell("alive")
        except OSError:
            raise InstrumentError(_GONE) from None

    def answer_for(self, instruments: Collection[str]) -> None:
        """Announces instruments that will be commanded from now on, so that the watchdog can make them safe. Raises
        `InstrumentError` if the watchdog has ended, so that no instrument is commanded without it."""
        try:
            self._tell(json.dumps({"answer_for": sorted(instruments)}))
        except OSError:
            raise InstrumentError(_GONE) from None

    def report_to(self, folder: Path) -> None:
        """Sends the path of the run folder to the watchdog. If the watchdog acts, it writes a report to this folder."""
        with contextlib.suppress(OSError):  # the next heartbeat reports it
            self._tell(json.dumps({"report": str(folder.absolute())}))

    def stand_down(self) -> None:
        """Informs the watchdog that the bench is safe. The watchdog then ends without acting."""
        with contextlib.suppress(OSError):
            self._tell("safe")
        self._part(LEAVING)

    def let_act(self) -> None:
        """Lets the watchdog make the bench safe with new connections, because this process could not make the bench safe. Waits
        until the watchdog has finished."""
        self._part(ENDING)

    @property
    def _stdin(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    def _tell(self, line: str) -> None:
        """Sends a line to the watchdog. Raises `OSError` if the watchdog has ended or has not read for too long."""
        data = memoryview(f"{line}\n".encode())
        while data:
            written = self._stdin.write(data)
            if written is None:
                raise BlockingIOError
            data = data[written:]

    def _part(self, patience: float) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError, AttributeError):
                pipe.close()  # type: ignore[union-attr]
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)


def _start() -> subprocess.Popen[bytes]:
    own_session, flags = os.name != "nt", 0  # Ctrl-C in the terminal must not reach the watchdog
    if not own_session:  # pragma: no cover (not the platform of continuous integration)
        # Nor must closing the console, which ends every process attached to it.
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW  # type: ignore[attr-defined,unused-ignore]
    command = [sys.executable, "-m", "planrunner.bench.watchdog_start"]
    pipe = subprocess.PIPE
    try:
        return subprocess.Popen(
            command, stdin=pipe, stdout=pipe, bufsize=0, start_new_session=own_session, creationflags=flags
        )
    except OSError as error:
        raise InstrumentError(f"the watchdog process cannot be started: {error.strerror or error}") from None


def _first_line(process: subprocess.Popen[bytes], patience: float) -> str:
    """Returns the first line that the watchdog prints, or the reason if there is none. A thread reads the line, because not every
    operating system can wait for a pipe with a time limit."""
    assert process.stdout is not None
    found: list[bytes] = []
    reader = threading.Thread(target=lambda: found.append(process.stdout.readline()), daemon=True)  # type: ignore[union-attr]
    reader.start()
    reader.join(patience)
    if not found:
        return f"no answer within {patience:.0f} s"
    return found[0].decode("utf-8", "replace").strip() or "it ended at once"
