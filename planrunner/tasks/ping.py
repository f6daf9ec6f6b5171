"""Asks every instrument of a bench for its identity and its readings. No instrument moves."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from planrunner.base.documents import JsonObject
from planrunner.bench.clock import VirtualClock, WallClock
from planrunner.bench.lock import bench_lock
from planrunner.bench.model import Bench, driver_of, runs_on_virtual_clock, site_of
from planrunner.bench.opening import real_clock
from planrunner.instruments.interfaces import Alive, Instrument, InstrumentError, Readable, Surroundings, Watched

TIMES = 3
"""Number of exchanges. The round-trip time is the median of their durations."""


@dataclass(frozen=True, slots=True)
class Ping:
    """Contains the answer of one instrument of a bench.

    `identity`, `readings`: identity and readings as the instrument reports them. `faults`: reasons why the instrument could not be
    used now. `round_trip`: time from question to answer, s. `failure`: the reason why the instrument could not be asked; empty if
    it answered.
    """

    name: str
    driver: str
    identity: Mapping[str, str] = field(default_factory=dict)
    readings: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    round_trip: float | None = None
    failure: str = ""

    def to_json(self) -> JsonObject:
        return {
            "name": self.name,
            "driver": self.driver,
            "identity": dict(self.identity),
            "readings": dict(self.readings),
            "faults": list(self.faults),
            "round_trip_s": self.round_trip,
            "failure": self.failure,
        }


def ping(bench: Bench, shown: str, data_root: Path | None = None) -> list[Ping]:
    """Connects to every instrument in the order of the bench file, asks it for its identity and readings, and disconnects. If an
    instrument fails, the next one is still asked. `shown`: name of the bench file, for messages. Raises `InputError` if a run is
    using the bench."""
    clock = VirtualClock() if runs_on_virtual_clock(bench) else real_clock(bench)
    surroundings = Surroundings(clock, site_of(bench), data_root, bench.seed, real_time=isinstance(clock, WallClock))
    answers = []
    with bench_lock(bench, shown, "a ping"):
        for name, entry in bench.instruments.items():
            try:
                instrument = driver_of(entry).connect(entry.parameters, surroundings)
            except Exception as error:  # whatever a driver raises, the next instrument is asked
                answers.append(Ping(name, entry.driver, failure=_in_words(error)))
                continue
            surroundings.instruments[driver_of(entry).role] = instrument
            try:
                answers.append(_asked(name, entry.driver, instrument))
            except Exception as error:
                answers.append(Ping(name, entry.driver, failure=_in_words(error)))
            finally:
                instrument.close()
    return answers


def _asked(name: str, driver: str, instrument: Instrument) -> Ping:
    identity = {key: str(value) for key, value in instrument.identify().items()}
    ask = instrument.heartbeat if isinstance(instrument, Alive) else instrument.identify
    trips = []
    for _ in range(TIMES):
        start = time.perf_counter()
        ask()
        trips.append(time.perf_counter() - start)
    readings = dict(instrument.read()) if isinstance(instrument, Readable) else {}
    faults = instrument.watch().faults if isinstance(instrument, Watched) else ()
    return Ping(name, driver, identity, readings, tuple(faults), median(trips))


def _in_words(error: Exception) -> str:
    if isinstance(error, InstrumentError):
        return str(error)
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
