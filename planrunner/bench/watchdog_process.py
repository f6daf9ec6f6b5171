"""The watchdog process, started by `planrunner.bench.watchdog` through `planrunner.bench.watchdog_start`.

The watchdog reads from its standard input: first the bench that it guards, then heartbeats and the names of the instruments that
planrunner controls. The watchdog makes the bench safe in two cases: if the input ends without the word `safe`, and if the heartbeat
stops for too long. In the second case, it first ends planrunner, because planrunner may hold exclusive connections and might
continue to send commands. To make the bench safe, it connects to every real instrument that planrunner controlled, using only the
bench file, and brings the instrument to its safe state. If an instrument hangs or fails, the watchdog continues with the next
instrument. Instruments to which planrunner had only connected are left as they are. The watchdog reports to the run folder and on
its standard error stream. While the watchdog exists, no other run can use the bench (`bench.lock`).
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import queue
import signal
import sys
import threading
import time
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import NoReturn

from planrunner.base.documents import JsonObject
from planrunner.base.findings import InputError
from planrunner.bench.clock import WallClock
from planrunner.bench.lock import watchdog_lock
from planrunner.bench.model import Bench, driver_of, parse_bench, real_instruments, site_of
from planrunner.bench.opening import real_clock
from planrunner.bench.watchdog_report import append_report
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.plan import source

ATTEMPTS = 3
BETWEEN = 1.0
"""Number of attempts with each instrument, and the time between two attempts, s."""
PATIENCE = 30.0
"""Time [s] after which the watchdog stops waiting for an instrument that does not respond, and continues with the next one."""
ENDED_WITHIN = 5.0
"""Maximum time [s] within which the operating system ends planrunner."""


@dataclass(slots=True)
class Charge:
    """The run that the watchdog guards.

    `parent`: process number of planrunner. `report`: the run folder, None until it exists. `controlled`: names of the instruments
    that planrunner commands.
    """

    bench: Bench
    shown: str
    data_root: Path | None
    silence: float
    parent: int
    report: Path | None = None
    controlled: set[str] = field(default_factory=set)


def main() -> int:
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    with contextlib.ExitStack() as stack:
        try:
            charge = _read_charge(lines.get(timeout=PATIENCE))
            stack.enter_context(watchdog_lock(charge.bench, charge.shown))
        except (queue.Empty, ValueError, KeyError, InputError) as error:
            print(f"{error or type(error).__name__}".splitlines()[0], flush=True)
            return 2
        print("ready", flush=True)
        reason = _guard(charge, lines)
        if reason is not None and (charge.controlled or charge.report is not None):
            _tell(charge, reason, rescue(charge))
    return 0


def _listen(lines: queue.SimpleQueue[bytes]) -> None:
    """Puts every line of the input into a queue, and an empty line when the input ends."""
    for line in iter(sys.stdin.buffer.readline, b""):
        lines.put(line)
    lines.put(b"")


def _read_charge(line: bytes) -> Charge:
    told: JsonObject = json.loads(line)
    shown = told["shown"]
    bench, log = parse_bench(source.parse(source.decode(base64.b64decode(told["bench"]), shown), shown))
    if bench is None or log.errors:
        raise InputError(log)
    root = None if told["data_root"] is None else Path(told["data_root"])
    return Charge(bench, shown, root, told["silence"], told["parent"])


def _guard(charge: Charge, lines: queue.SimpleQueue[bytes]) -> str | None:
    """Waits for the end of the run. Returns None when planrunner reports that the bench is safe. Returns the reason when the
    watchdog must make the bench safe. The absence of a heartbeat counts only after the first heartbeat, because connecting takes
    time and nothing has moved yet."""
    begun = False
    while True:
        try:
            line = lines.get(timeout=charge.silence if begun else None).strip()
        except queue.Empty:
            return f"planrunner gave no sign of life for {charge.silence:g} s and {_ended(charge.parent)}"
        if line == b"safe":
            return None
        begun = begun or line == b"alive"
        if line == b"":
            return "planrunner ended without leaving the bench safe"
        if line.startswith(b"{"):
            _hear(charge, json.loads(line))


def _hear(charge: Charge, told: JsonObject) -> None:
    if "report" in told:
        charge.report = Path(told["report"])
    charge.controlled |= set(told.get("answer_for", ()))


def _ended(parent: int) -> str:
    """Ends planrunner, and returns the outcome in words. The process number certainly belongs to planrunner, because the pipe from
    planrunner is still open."""
    number = getattr(signal, "SIGKILL", signal.SIGTERM)  # on Windows both signals end a process
    try:
        os.kill(parent, number)
    except OSError as error:
        return f"cannot be ended ({error.strerror or error})"
    deadline = time.monotonic() + ENDED_WITHIN
    while os.name != "nt" and os.getppid() == parent and time.monotonic() < deadline:
        time.sleep(0.05)
    return "was ended; `planrunner resume` continues the run"


def rescue(charge: Charge) -> list[str]:
    """Makes safe every real instrument that planrunner controlled, in the bench's order. Returns a line of text about each real
    instrument."""
    return [
        f"{name}: {_made_safe(charge, name) if name in charge.controlled else 'left as it was, never commanded'}"
        for name in real_instruments(charge.bench)
    ]


def _made_safe(charge: Charge, name: str) -> str:
    told = "not asked"
    for attempt in range(ATTEMPTS):
        if attempt:
            time.sleep(BETWEEN)
        done: list[str] = []
        thread = threading.Thread(target=_make_safe, args=(charge, name, done), daemon=True)
        thread.start()
        thread.join(PATIENCE)
        told = done[0] if done else f"NOT SAFE, the command did not return within {PATIENCE:g} s"
        if told == "safe" or not done:
            break
    return told


def _make_safe(charge: Charge, name: str, done: list[str]) -> None:
    entry = charge.bench.instruments[name]
    site = site_of(charge.bench)
    surroundings = Surroundings(_clock(charge.bench), site, charge.data_root, charge.bench.seed, real_time=True)
    try:
        instrument = driver_of(entry).connect(entry.parameters, surroundings)
        try:
            instrument.make_safe()
        finally:
            instrument.close()
    except BaseException as error:  # a driver may raise anything; continue with the next one
        done.append(f"NOT SAFE, {error or type(error).__name__}")
    else:
        done.append("safe")


def _clock(bench: Bench) -> WallClock:
    try:
        return real_clock(bench)
    except InstrumentError:  # the process that simulates the bench is gone, or other programs use its addresses
        return WallClock()


def _tell(charge: Charge, reason: str, lines: list[str]) -> None:
    when = datetime.now().astimezone().isoformat(timespec="seconds")
    text = "\n".join([f"{when} watchdog: {reason}", *(f"  {line}" for line in lines)]) + "\n"
    with contextlib.suppress(OSError, ValueError):  # standard error may be closed
        sys.stderr.write(text)
    if charge.report is not None:
        with contextlib.suppress(OSError):
            append_report(charge.report, text)


def live() -> NoReturn:
    """Runs the watchdog process until it ends."""
    code = main()
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.flush()
    os._exit(code)  # even if a driver or the listening thread is still busy
