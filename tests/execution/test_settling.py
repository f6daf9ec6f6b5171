"""Settling by what is measured: when it ends, what it waits for, and how it is given up. Courses are set; times are worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from fake_bench import Bench, make_bench, segment
from test_executor import carry_out
from watched_bench import make_watched_bench

from planrunner.instruments.interfaces import Condition
from planrunner.plan.schedule import Schedule, Spin, Stability

ARCSEC = math.pi / 180 / 3600


def one(**given: object) -> Schedule:
    return Schedule((segment(0, "P1", **given),), 0.0)


def recording_began(bench: Bench) -> float:
    """The clock's time when the sensor's first block came; the fake sensor notes nothing, so its samples tell."""
    return bench.clock.now() - 10.0  # the dwell


def test_settling_ends_when_a_decaying_error_has_stayed_small(tmp_path: Path) -> None:
    """100″·e^(−t/10) from the end of the 5 s move falls below 2″ after 10·ln 50 = 39.1 s; it must stay there for 20 s."""
    bench = make_watched_bench()
    bench.table.course = lambda now: Condition({"position_error": 100 * ARCSEC * math.exp(-(now - 5) / 10)})
    stable = Stability({"position_error": 2 * ARCSEC}, 20.0, 120.0)
    outcome, _ = carry_out(tmp_path, bench, one(settle=20.0, stable=stable))
    assert outcome.ok
    assert recording_began(bench) == pytest.approx(5 + 39.12 + 20, abs=2.1)  # looks are a second apart


def test_an_excursion_begins_the_wait_anew(tmp_path: Path) -> None:
    """Quiet from the beginning, but disturbed from 12 s to 14 s: settled 10 s after that, not after the 10 s of quiet."""
    bench = make_watched_bench()
    bench.table.course = lambda now: Condition({"rate_error": 1.0 if 12 <= now <= 14 else 0.0})
    stable = Stability({"rate_error": 1e-3}, 10.0, 60.0)
    outcome, _ = carry_out(tmp_path, bench, one(settle=10.0, stable=stable, motion=Spin(1.0)))
    assert outcome.ok
    # move 5, spin-up 2: settling from 7; disturbed until 14; dwell 10 and coming to rest 2 afterwards
    assert bench.clock.now() - 12 == pytest.approx(14 + 10, abs=1.1)
    assert "table.begin Spin 70" in bench.calls  # the table must spin for as long as settling may take, and the dwell


def test_a_soak_ends_when_the_temperature_no_longer_drifts(tmp_path: Path) -> None:
    """The sensor nears 320 K with a time constant of 100 s: its drift over the last 50 s,
    (10/50)·(e^(−(t−50)/100) − e^(−t/100)), falls to 0.01 K/s near t = 100·ln(0.2·(e^0.5 − 1)/0.01) = 256 s. The chord differs
    from the fitted line by less than the look's second."""
    bench = make_watched_bench()
    began = {"at": 0.0}

    def sensor(now: float) -> Condition:
        return Condition({"temperature": 320.0 - 10 * math.exp(-(now - began["at"]) / 100)})

    bench.sensor.watch = lambda: sensor(bench.clock.now())
    soaked = Stability({"temperature_drift": 0.01}, 50.0, 1000.0)
    outcome, _ = carry_out(
        tmp_path, bench, one(temperature=298.15, soak=50.0, soaked=soaked, settle=0.0, attitude=None)
    )
    assert outcome.ok
    assert recording_began(bench) == pytest.approx(256.0, abs=6.0)


def test_the_air_is_held_against_the_commanded_temperature(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.chamber.course = lambda now: Condition({"temperature": 308.15 + max(0.0, 2 - now / 100)})
    soaked = Stability({"temperature_error": 0.5}, 10.0, 600.0)
    outcome, _ = carry_out(
        tmp_path, bench, one(temperature=308.15, soak=10.0, soaked=soaked, settle=0.0, attitude=None)
    )
    assert outcome.ok
    assert recording_began(bench) == pytest.approx(150 + 10, abs=2.1)


def test_what_never_settles_is_given_up_with_the_reading(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.table.course = lambda now: Condition({"position_error": 3 * ARCSEC})
    stable = Stability({"position_error": 2 * ARCSEC}, 10.0, 60.0)
    outcome, _ = carry_out(tmp_path, bench, one(settle=10.0, stable=stable))
    assert str(outcome.failures[0]).startswith(
        "segment 'P1', settling: 'P1' has not settled within 60 s: position error 3 arcsec is more than the 2 arcsec that the plan allows"
    )
    assert bench.clock.now() == pytest.approx(5 + 60, abs=2.1)
    assert bench.calls[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]


def test_a_reading_that_nobody_gives_is_reported(tmp_path: Path) -> None:
    bench = make_watched_bench()
    outcome, _ = carry_out(tmp_path, bench, one(stable=Stability({"rate_error": 1.0}, 2.0, 5.0)))
    assert "no instrument reports the rate error" in outcome.failures[0].message


def test_a_bench_without_readings_waits_for_the_time(tmp_path: Path) -> None:
    """What is simulated is steady when it says so."""
    bench = make_bench(block=1000)
    outcome, _ = carry_out(tmp_path, bench, one(settle=30.0, stable=Stability({"rate_error": 1.0}, 30.0, 60.0)))
    assert outcome.ok
    assert bench.clock.now() == 5 + 30 + 10
