"""Connects the instruments and the clock of a bench, and makes the bench safe.

Only the instruments that this process has taken control of are made safe. An instrument to which planrunner has only connected is
not changed, because planrunner must not stop an instrument that someone else started. When the bench is made safe, each instrument
is tried in the bench's order, even if others fail. If an instrument cannot be connected, connecting stops, and the instruments that
are already connected are released.

For a run, the bench is locked against other runs, then guarded by a watchdog, then connected, and at the end made safe. A bench
without real instruments needs neither a lock nor a watchdog.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from planrunner.base.progress import Announce
from planrunner.bench.clock import VirtualClock, WallClock
from planrunner.bench.lock import bench_lock
from planrunner.bench.model import (
    Bench,
    driver_of,
    real_instruments,
    runs_on_virtual_clock,
    safe_order,
    site_of,
)
from planrunner.bench.protection import own_limits
from planrunner.bench.simulation import attach
from planrunner.bench.watchdog import Watchdog
from planrunner.instruments.interfaces import Addressed, Instrument, InstrumentError, OwnLimits, RunClock, Surroundings
from planrunner.physics.earth import Site


class NotSafeError(InstrumentError):
    """Reports that something on a bench could not be brought to its safe state."""


@dataclass(frozen=True, slots=True)
class SafetyFailure:
    """Names an instrument that could not be made safe or disconnected, and the reason."""

    instrument: str
    message: str

    def __str__(self) -> str:
        return f"{self.instrument}: {self.message}"


class OpenBench:
    """A bench whose instruments are connected. The bench is a context manager: on exit, it makes the controlled instruments safe
    and then disconnects all instruments.

    `table`, `chamber`, `sensor`: the instrument of that role, or None. `instruments`: maps the name of each instrument to the
    instrument. `limits`: the limits that the instruments must enforce themselves. `watchdog`: the watchdog, if one guards the
    bench. `safe`: True if the last attempt brought all controlled instruments to their safe state.
    """

    def __init__(self, bench: Bench, clock: RunClock, site: Site):
        self.bench = bench
        self.clock = clock
        self.site = site
        self.instruments: Mapping[str, Instrument] = {}
        self._roles: Mapping[str, str] = {}
        self.watchdog: Watchdog | None = None
        self.safe = False
        self._controlled: set[str] = set()

    @property
    def table(self) -> Instrument | None:
        return self._of_role("table")

    @property
    def chamber(self) -> Instrument | None:
        return self._of_role("chamber")

    @property
    def sensor(self) -> Instrument | None:
        return self._of_role("sensor")

    def _of_role(self, role: str) -> Instrument | None:
        return next((item for name, item in self.instruments.items() if self._roles[name] == role), None)

    @property
    def limits(self) -> OwnLimits:
        return own_limits(self.bench.protection)

    def sign_of_life(self) -> None:
        """Informs the watchdog that planrunner is at work. Raises `InstrumentError` if the watchdog has ended."""
        if self.watchdog is not None:
            self.watchdog.sign_of_life()

    def add(self, name: str, role: str, instrument: Instrument) -> None:
        """Adds a connected instrument."""
        self.instruments = {**self.instruments, name: instrument}
        self._roles = {**self._roles, name: role}

    def take_control(self, *names: str) -> None:
        """Declares that, from now on, this process commands these instruments (by default all). At the end, the process makes these
        instruments safe; if this fails, its watchdog makes them safe. Call this method before the first command. Raises
        `InstrumentError` if the watchdog has ended."""
        added = set(names or self.instruments) - self._controlled
        if added and self.watchdog is not None:
            self.watchdog.answer_for(added)
        self._controlled |= added

    @property
    def untouched(self) -> tuple[str, ...]:
        """Returns the instruments that were never commanded and are therefore left as they were."""
        return tuple(name for name in self.instruments if name not in self._controlled)

    def make_safe(self) -> list[SafetyFailure]:
        """Brings every controlled instrument to its safe state in the bench's order; returns the failures."""
        self.safe = False
        failures = self._each(lambda instrument: instrument.make_safe(), self._controlled)
        self.safe = not failures
        return failures

    def close(self) -> list[SafetyFailure]:
        """Disconnects every instrument; returns the failures. May be called twice."""
        failures = self._each(lambda instrument: instrument.close(), self.instruments)
        self.instruments = {}
        return failures

    def _each(self, action: Callable[[Instrument], None], names: Container[str]) -> list[SafetyFailure]:
        failures = []
        for name in safe_order(self.bench):
            if name not in self.instruments or name not in names:
                continue
            with contextlib.suppress(InstrumentError):  # continue although the watchdog is lost
                self.sign_of_life()
            try:
                action(self.instruments[name])
            except Exception as error:  # a driver may raise anything; continue with the next instrument
                failures.append(SafetyFailure(name, f"{error}" or type(error).__name__))
        return failures

    def __enter__(self) -> OpenBench:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        unsafe = self.make_safe()
        failures = unsafe + [failure for failure in self.close() if failure.instrument in self._controlled]
        if failures:
            message = "not all instruments could be made safe: " + "; ".join(map(str, failures))
            raise NotSafeError(message) from error


def real_clock(bench: Bench) -> WallClock:
    """Returns a clock of real time. If a separate process simulates the bench, the clock has the speed of this process."""
    if bench.simulation is None:
        return WallClock()
    drivers = {name: driver_of(entry) for name, entry in bench.instruments.items()}
    addresses = {
        name: driver.address(bench.instruments[name].parameters)
        for name, driver in drivers.items()
        if issubclass(driver, Addressed)
    }
    return attach(bench.simulation, addresses)


def open_bench(
    bench: Bench,
    *,
    data_root: Path | None = None,
    seed: int | None = None,
    clock: RunClock | None = None,
    notice: Announce | None = None,
) -> OpenBench:
    """Connects the instruments of a bench in the order of its file.

    `data_root`: folder that must contain the recordings. `seed`: seed of all random numbers of a simulated bench; by default the
    seed in the bench file. `clock`: a clock that replaces the clock that the bench file states. `notice`: receives the progress of
    work before the run. Raises `InstrumentError` with the name of the instrument that could not be connected; the instruments
    connected before it are closed without being commanded.
    """
    virtual = runs_on_virtual_clock(bench)
    clock = clock or (VirtualClock() if virtual else real_clock(bench))
    site = site_of(bench)
    chosen_seed = bench.seed if seed is None else seed
    surroundings = Surroundings(clock, site, data_root, chosen_seed, real_time=not virtual, notice=notice)
    opened = OpenBench(bench, clock, site)
    for name, entry in bench.instruments.items():
        try:
            driver = driver_of(entry)
            instrument = driver.connect(entry.parameters, surroundings)
        except BaseException as error:
            connected = tuple(opened.instruments)
            opened.close()
            if not isinstance(error, Exception):
                raise
            reason = f"{error}" or type(error).__name__
            left = f" ({', '.join(connected)}: left unchanged, no command was sent)" if connected else ""
            raise InstrumentError(f"{name} ({entry.driver}) cannot be connected: {reason}{left}") from error
        opened.add(name, driver.role, instrument)
        surroundings.instruments[driver.role] = instrument
    return opened


@contextmanager
def guarded_bench(
    bench: Bench,
    bench_file: bytes,
    shown: str,
    *,
    data_root: Path | None = None,
    seed: int | None = None,
    notice: Announce | None = None,
) -> Iterator[OpenBench]:
    """Connects the bench for the duration of a `with` block. At the end of the block, the bench is made safe and closed.

    `bench_file`: the exact bytes of the bench file, which the watchdog uses to connect. `shown`: name of the bench file in
    messages. `notice`: receives the progress of work before the run, as in `open_bench`. Raises `InputError` if another run holds
    the bench, and `InstrumentError` if the watchdog or an instrument fails.
    """
    with bench_lock(bench, shown):
        watchdog = None
        if real_instruments(bench) and not runs_on_virtual_clock(bench):
            silence = bench.protection.silence.value
            watchdog = Watchdog(bench_file, shown, data_root, silence)
        safe = False
        try:
            # Until the bench is controlled, the watchdog does nothing if this process ends.
            opened = open_bench(bench, data_root=data_root, seed=seed, notice=notice)
            opened.watchdog = watchdog
            try:
                with opened:
                    yield opened
            finally:
                safe = opened.safe
        finally:
            if watchdog is not None:
                watchdog.stand_down() if safe else watchdog.let_act()
