"""Effects that have a shape and no amplitude, on recordings of the blind campaign's generator, which shares no code with the diagnosis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planrunner.gap.answer.diagnosis import Diagnosis, diagnose
from tests.blind import folder
from tests.blind.device import SENSORS, clean_output, limit, random_device
from tests.blind.effects import KINDS
from tests.blind.generator import Case, Work, _of_strength, signatures, simulate
from tests.blind.product import observation


def _diagnosed(
    here: Path, plan: str, sensor: str, effect: str, energy: float, seed: int, sign: float = 1.0
) -> tuple[Diagnosis, float]:
    """A diagnosis of an effect of some strength, and its true shape."""
    draw, kind = np.random.default_rng(seed), SENSORS[sensor]
    around = signatures(plan, sensor)
    work = Work(around, (1.0,) * len(kind.triads), random_device(kind, draw))
    fault = _of_strength(KINDS[effect], sign * np.array(KINDS[effect].scale), (), energy, work)
    assert fault is not None
    columns = simulate(work, [fault], False, draw)
    folder.write_setups(here)
    folder.write_case(here, Case("case-0", plan, sensor, columns, {}, (fault,), work.device), seed)
    true = float(fault.theta[0])
    if effect == "gyro_saturation":
        true = limit(clean_output(around.schedule, kind, work.device, {})[:, :3], true)
    return diagnose(observation(folder.shown(here, "case-0"))), true


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plan", "sensor", "energy", "seed"),
    [("poor", "fog", 400.0, 4), ("poor", "mems", 900.0, 5), ("tumble", "mems", 200.0, 8)],
)
def test_a_dead_zone_is_found_within_its_interval(
    tmp_path: Path, plan: str, sensor: str, energy: float, seed: int
) -> None:
    found, true = _diagnosed(tmp_path, plan, sensor, "gyro_dead_zone", energy, seed)
    assert found.verdict.effects == ("gyro_dead_zone",)
    (one,) = found.parameters
    assert one.name == "d" and one.standard_uncertainty < 0.1 * true
    assert abs(one.value - true) < 3 * one.standard_uncertainty


@pytest.mark.slow
def test_a_strong_dead_zone_stands_alone(tmp_path: Path) -> None:
    """At some eighty standard deviations the nominal parameters fitted without it are far off: looked for where those put the output, it
    leaves a fifth of itself to be named besides."""
    found, true = _diagnosed(tmp_path, "tumble", "fog", "gyro_dead_zone", 6000.0, 4)
    assert found.verdict.effects == ("gyro_dead_zone",)
    assert found.posterior.probability["gyro_dead_zone"] > 0.8
    (one,) = found.parameters
    assert abs(one.value - true) < 3 * one.standard_uncertainty


def test_a_limit_is_found_within_its_interval(tmp_path: Path) -> None:
    """The limit cuts the noise too, which lowers the mean of outputs just below the limit."""
    found, true = _diagnosed(tmp_path, "poor", "mems", "gyro_saturation", 500.0, 3)
    assert found.verdict.effects == ("gyro_saturation",)
    (one,) = found.parameters
    assert one.name == "limit"
    assert abs(one.value - true) < 3 * one.standard_uncertainty


@pytest.mark.slow
def test_a_delay_far_below_the_grid_is_found(tmp_path: Path) -> None:
    """Less than a microsecond: what rocking shows of it is in proportion to it, so that any would do, with an amplitude."""
    found, true = _diagnosed(tmp_path, "rocking", "fog", "time_latency", 900.0, 7)
    assert "time_latency" in found.verdict.effects
    (one,) = found.parameters
    assert abs(one.value - true) < 3 * one.standard_uncertainty


@pytest.mark.slow
@pytest.mark.parametrize("energy", [40.0, 400.0])
@pytest.mark.filterwarnings("error")
def test_a_delay_the_other_way_round_is_negative(tmp_path: Path, energy: float) -> None:
    """The table's angle that comes late: no delay of the sensor, however short, explains that."""
    found, true = _diagnosed(tmp_path, "rocking", "mems", "time_latency", energy, 1, -1.0)
    assert "time_latency" in (*found.verdict.effects, *found.verdict.members) and true < 0
    (one,) = found.parameters
    assert one.name == "delay" and abs(one.value - true) < 3 * one.standard_uncertainty < 0.7 * abs(true)
