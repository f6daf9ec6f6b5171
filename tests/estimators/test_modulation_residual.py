"""Navigations with and without rotation: ratios and suppression by hand, the part that repeats with the cycle recovered from what it was
made of, and predictions against a Schuler loop integrated apart."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recorded import figure, from_means, segment, sensor
from scipy.integrate import solve_ivp

from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Setup,
)
from planrunner.estimators.method import designed
from planrunner.estimators.modulation.fit import TooLittleError, free_rates, periodic_part
from planrunner.estimators.modulation.modulation_residual import ModulationResidual, ModulationResidualParameters
from planrunner.estimators.modulation.prediction import errors_over_time, periodic_amplitudes
from planrunner.instruments.models import TableModel
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis
from planrunner.physics.modulation import schuler_drive
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Cycle, Motion, Move, Rest
from planrunner.tasks.check import check_plan
from tests.counted_calls import calls

DEG = math.pi / 180
SITE = Site(45 * DEG, 9.806)
PRINTED = (180, 90, -180, -90, -180, -90, 180, 90)
EIGHT = (90, 90, -90, -90, -90, -90, 90, 90)
TABLE = TableModel((TableAxis("azimuth", (0.0, 0.0, 1.0), 100 * DEG, 5 * DEG),))


def cycle(turns: tuple[int, ...] = EIGHT, stop: float = 180.0) -> RotationCycle:
    return RotationCycle(tuple(turn * DEG for turn in turns), stop, 10 * DEG, 5 * DEG)


def motion(turns: tuple[int, ...]) -> Cycle:
    angles, names = 0, "ABCD"
    moves = []
    for turn in turns:
        begin, angles = angles, angles + turn
        moves.append(Move(names[begin // 90 % 4], turn * DEG, names[angles // 90 % 4]))
    return Cycle({name: 90 * index * DEG for index, name in enumerate(names)}, tuple(moves), 10 * DEG, 180.0)


# -- the part that repeats -----------------------------------------------------------------------------------------------


def signal(period: float, seconds: float, step: float, parts: dict[int, complex]) -> tuple[Any, Any]:
    """A velocity of known harmonics beside a trend and all free oscillations."""
    time = np.arange(0, seconds, step)
    velocity = (0.2 - 0.1j) + (0.3 + 0.2j) * time / seconds
    for rate, size in zip(free_rates(SITE), (0.8 + 0.1j, -0.5j, 0.9, 0.3 - 0.2j), strict=True):
        velocity = velocity + size * np.exp(1j * rate * time)
    for order, size in parts.items():
        velocity = velocity + size * np.exp(2j * math.pi * order * time / period)
    return time, velocity


def test_harmonics_are_recovered_beside_free_oscillations() -> None:
    parts = {1: 0.1 + 0.02j, -1: 0.03j, 2: -0.04, -3: 0.01 - 0.01j}
    time, velocity = signal(1528.0, 86400.0, 45.0, parts)
    found = periodic_part(time, velocity, 1528.0, 4, SITE)
    given = dict(zip(found.orders.tolist(), found.velocities.tolist(), strict=True))
    for order in (1, -1, 2, -2, 3, -3, 4, -4):
        assert given[order] == pytest.approx(parts.get(order, 0.0), abs=1e-9)
    assert not found.hidden
    # One circular harmonic of velocity v and rate ω moves round a circle of v/ω.
    alone = periodic_part(*signal(1528.0, 86400.0, 45.0, {2: 0.05j}), 1528.0, 4, SITE)
    assert alone.largest_velocity() == pytest.approx(0.05, rel=1e-6)
    assert alone.largest_position() == pytest.approx(0.05 * 1528 / (4 * math.pi), rel=1e-6)


def test_the_stated_noise_is_what_harmonics_scatter_by() -> None:
    generator = np.random.default_rng(5)
    time, clean = signal(1528.0, 43200.0, 45.0, {1: 0.1})
    errors, stated = [], []
    for _ in range(60):
        noisy = clean + 0.02 * (generator.standard_normal(time.size) + 1j * generator.standard_normal(time.size))
        found = periodic_part(time, noisy, 1528.0, 2, SITE)
        errors.append(found.velocities[found.orders == 1][0] - 0.1)
        stated.append(found.noise[found.orders == 1][0])
    scatter = math.sqrt(float(np.mean(np.abs(errors) ** 2)))
    # 120 squared normal values scatter by √(2/120) = 13 %; three times that, and what fitting removes beside a harmonic.
    assert float(np.mean(np.square(stated))) / scatter**2 == pytest.approx(1.0, abs=0.45)


def test_harmonics_near_a_free_oscillation_are_left_out() -> None:
    period = 2 * math.pi / free_rates(SITE)[0]
    time, velocity = signal(period, 24 * 3600.0, 45.0, {2: 0.05})
    found = periodic_part(time, velocity, period, 2, SITE)
    assert found.hidden == (1,)
    assert found.velocities[found.orders == 2][0] == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize(
    ("seconds", "step", "words"), [(4000.0, 45.0, "2 whole cycles"), (86400.0, 900.0, "too far for a cycle of 1528 s")]
)
def test_records_without_information(seconds: float, step: float, words: str) -> None:
    with pytest.raises(TooLittleError, match=words):
        periodic_part(*signal(1528.0, seconds, step, {}), 1528.0, 4, SITE)
    time = np.array([0.0, 1, 3, 9000])
    with pytest.raises(TooLittleError, match="not evenly spaced"):
        periodic_part(time, time + 0j, 1528.0, 4, SITE)


# -- predictions ---------------------------------------------------------------------------------------------------------


def loop(gyro: complex, accelerometer: complex, one: RotationCycle, seconds: float, site: Site) -> complex:
    """Position after `seconds` by the Schuler loop alone, v′ = −i·g·ψ + b, ψ′ = ε − i·v/R, from a level start."""
    radius = 6_371_000.0

    def slope(time: float, state: NDArray[np.complex128]) -> list[complex]:
        turned = cmath.exp(1j * float(one.angle(np.array([time]))[0]))
        velocity = state[1]
        tilt = -1j * site.gravity * state[2] + accelerometer * turned
        return [velocity, tilt, gyro * turned - 1j * velocity / radius]

    return complex(solve_ivp(slope, (0, seconds), [0j, 0j, 0j], rtol=1e-8, atol=1e-10, max_step=5).y[0, -1])


@pytest.mark.parametrize("turns", [PRINTED, EIGHT])
def test_predicted_positions_against_an_integrated_loop(turns: tuple[int, ...]) -> None:
    # On an Earth that hardly turns, the equations are those of the loop but for the ellipsoid's radii.
    one = cycle(turns, stop=120)
    gyro, accelerometer = (0.02 - 0.015j) * DEG / 3600, 5e-4 - 4e-4j
    errors = np.array([gyro.real, gyro.imag, 0, accelerometer.real, accelerometer.imag, 0])
    balanced = cycle(EIGHT)
    site = replace(SITE, earth_rate=1e-9)
    time, position = errors_over_time(errors, np.eye(3), one, balanced, 3600.0, site)
    expected = loop(gyro, accelerometer, one, 3600.0, site)
    assert time[-1] == 3600.0
    assert complex(*position[-1]) == pytest.approx(expected, rel=0.01)


def test_what_an_alignment_at_rest_hides_stays_hidden_at_rest_and_comes_out_by_turning() -> None:
    errors = np.array([0.02 * DEG / 3600, 0, 0, 5e-4, 0, 0])  # an east gyro and an east accelerometer
    _, still = errors_over_time(errors, np.eye(3), None, None, 6 * 3600.0, SITE)
    assert np.abs(still).max() < 1e-3  # m: gyrocompassing and levelling balance them exactly
    _, turned = errors_over_time(errors, np.eye(3), cycle(), None, 6 * 3600.0, SITE)
    _, aligned = errors_over_time(errors, np.eye(3), cycle(), cycle(), 6 * 3600.0, SITE)
    assert np.abs(turned).max() > 20 * np.abs(aligned).max()


def test_amplitudes_of_what_repeats_are_those_of_the_predicted_course() -> None:
    # The equations integrated over eight cycles against harmonic by harmonic: two ways to the same amplitude.
    one = cycle()
    errors = np.array([0.02, -0.015, 0, 0, 0, 0]) * DEG / 3600 + np.array([0, 0, 0, 5e-4, -4e-4, 0])
    time, position = errors_over_time(errors, np.eye(3), one, cycle(), 12 * one.period, SITE)
    speed = np.gradient(position[:, 0] + 1j * position[:, 1], time)
    found = periodic_part(time, speed, one.period, 8, SITE)
    velocity, place = periodic_amplitudes(errors, np.eye(3), one, found.orders, SITE)
    assert found.largest_velocity() == pytest.approx(velocity, rel=0.05)
    assert found.largest_position() == pytest.approx(place, rel=0.05)


@pytest.mark.parametrize("turns", [PRINTED, EIGHT])
def test_the_oscillation_that_check_warns_of_is_that_of_the_error_equations(turns: tuple[int, ...]) -> None:
    # Stops of 10 min: 24 h of an east drift of 0.02 deg/h, whose oscillation without rotation is R·ε = 0.62 m/s.
    one, site = cycle(turns, stop=600), Site(45.78 * DEG, 9.806)
    drift = 0.02 * DEG / 3600
    seconds = round(86400 / one.period) * one.period
    time, position = errors_over_time(np.array([drift, 0, 0, 0, 0, 0]), np.eye(3), one, one, seconds, site)
    peak = float(np.hypot(*np.gradient(position, time, axis=0).T).max()) / (6_371_000 * drift)
    assert schuler_drive(one, seconds, site) == pytest.approx(peak, rel=0.05)


# -- the estimate --------------------------------------------------------------------------------------------------------


def navigated(name: str, slope: float, hours: float = 6.0, u: float = 0.0, step: float = 60.0) -> Estimate:
    """A navigation whose error runs away evenly north-east at `slope` [m/s]."""
    time = np.arange(0.0, hours * 3600 + step / 2, step)
    leg = slope * time / math.sqrt(2)
    level = np.full(time.size, slope / math.sqrt(2))
    extra = {
        "time_s": time.tolist(), "east_m": leg.tolist(), "north_m": leg.tolist(), "velocity_east": level.tolist(),
        "velocity_north": level.tolist(), "cep_rate_nmi_h": 0.0, "duration_s": float(time[-1]),
    }  # fmt: skip
    rate = slope * 3600 / 1852
    coefficient = Coefficient("radial_error_rate", rate, "nmi/h", u * rate)
    return Estimate(
        name,
        "strapdown_navigation",
        (coefficient,),
        np.array([[u * rate]]) ** 2,
        segments=(f"align-{name}", name),
        extra=extra,
    )


def recorded(label: str, what: Motion) -> Any:
    return from_means(segment(label, np.eye(3), what), {"o": 0.0}, "pulse/s")


def request(*used: Estimate, motions: dict[str, Motion] | None = None, **parameters: Any) -> EstimateRequest:
    motions = motions or {"still": Rest(), "turned": motion(PRINTED), "other": motion(EIGHT)}
    segments = tuple(recorded(label, what) for label, what in motions.items())
    return EstimateRequest(
        "rotation", segments, ModulationResidualParameters(**parameters), SITE, sensor("o"), {one.name: one for one in used},
        setup=Setup(table=TABLE),
    )  # fmt: skip


def test_ratios_and_their_uncertainty_by_hand() -> None:
    found = ModulationResidual().estimate(
        request(navigated("still", 0.5, u=0.03), navigated("turned", 0.1, u=0.04), navigated("other", 0.05, hours=5))
    )
    # Everything is on the five hours that all have, where radial error is slope times time.
    assert found.settings["compared over"] == "18000 s"
    assert found["cep_rate_ratio_turned"].value == pytest.approx(0.2)
    assert found["cep_rate_ratio_turned"].standard_uncertainty == pytest.approx(0.2 * 0.05)  # 3 % and 4 %
    assert found["suppression_turned"].value == pytest.approx(5.0)
    assert found["suppression_other"].value == pytest.approx(10.0)
    assert found["suppression_other"].standard_uncertainty == pytest.approx(10 * 0.03)
    # Both suppressions rest on the same navigation at rest: covariance 5·10·0.03².
    names = [item.name for item in found.coefficients]
    at = names.index("suppression_turned"), names.index("suppression_other")
    assert found.covariance[at] == pytest.approx(50 * 0.03**2)
    cep = next(table for table in found.tables if "with and without" in table.title)
    assert cep.rows[0][-1] == pytest.approx(math.sqrt(math.log(2)) * 0.5 * 3600 / 1852)
    residual = next(table for table in found.tables if "Residual" in table.title)
    assert [row[2] for row in residual.rows] == ["23.03", "0.00"]
    picture = found.plots[0]
    assert picture.lines and set(picture.series) == {"still", "turned", "other"}
    assert picture.series["still"][-1] == pytest.approx(0.5 * 18000 / 1852)


def test_declared_errors_are_predicted_beside_what_is_measured() -> None:
    declared: dict[str, Any] = {
        "gyro_errors": tuple(map(parse_quantity, ("0.02 deg/h", "-0.015 deg/h", "0 deg/h"), ("angular rate",) * 3)),
        "accelerometer_errors": tuple(map(parse_quantity, ("50 ug", "-40 ug", "0 ug"), ("acceleration",) * 3)),
    }
    found = ModulationResidual().estimate(request(navigated("still", 0.5), navigated("turned", 0.1), **declared))
    tables = {table.title: table for table in found.tables}
    (row,) = next(table for title, table in tables.items() if "Residual" in title).rows
    assert figure(row[5]) > 0 and figure(row[7]) > 0
    names = [row[0] for row in next(table for title, table in tables.items() if "predicted" in title).rows]
    assert names == ["still", "turned"]


def test_short_records_are_compared_without_the_part_that_repeats() -> None:
    found = ModulationResidual().estimate(request(navigated("still", 0.5, hours=1), navigated("turned", 0.1)))
    assert [item.name for item in found.coefficients] == ["cep_rate_ratio_turned", "suppression_turned"]
    assert any("at least 4 are needed" in note for note in found.notes)


@pytest.mark.parametrize(
    ("used", "words"),
    [
        ((navigated("turned", 0.1), navigated("other", 0.1)), "none of the estimates used is without rotation"),
        ((navigated("still", 0.1),), "one of the estimates used is without rotation"),
        ((navigated("still", 0.1), replace(navigated("turned", 0.1), extra={})), "'turned' is not a navigation"),
        (
            (navigated("still", 0.1), navigated("elsewhere", 0.1)),
            "`segments` lacks the segment of the navigation 'elsewhere'",
        ),
        ((navigated("still", 0.0), navigated("turned", 0.1)), "'still' has no position error"),
        ((navigated("still", 0.1), navigated("turned", 0.0)), "'turned' has no position error"),
        ((navigated("still", 0.1, hours=0.01), navigated("turned", 0.1)), "fewer than three points"),
    ],
)
def test_what_cannot_be_compared(used: tuple[Estimate, ...], words: str) -> None:
    with pytest.raises(EstimationError, match=words):
        ModulationResidual().estimate(request(*used))


def test_design_says_what_cycles_leave_and_what_is_missing() -> None:
    segments = tuple(item.segment for item in request().segments)
    asked = DesignRequest(
        "rotation", segments, ModulationResidualParameters(), SITE, sensor("o"), setup=Setup(table=TABLE)
    )
    (remark,) = designed(ModulationResidual(), asked).remarks
    assert remark.error and remark.code == "physics-modulation" and remark.key == "uses"
    both: Any = {"a": Design(()), "b": Design(())}
    design = designed(ModulationResidual(), replace(asked, uses=both))
    assert not design.remarks
    assert "1.47 %" in design.notes[0]
    declared = parse_quantity("0.02 deg/h", "angular rate"), parse_quantity("0 deg/h", "angular rate")
    upright = replace(
        asked, uses=both, parameters=ModulationResidualParameters(gyro_errors=(declared[1], declared[1], declared[0]))
    )
    assert all(
        "cause 0 m rms" in note for note in designed(ModulationResidual(), upright).notes
    )  # about the vertical alone
    level = replace(
        asked, uses=both, parameters=ModulationResidualParameters(gyro_errors=(declared[0], declared[1], declared[1]))
    )
    assert not any("cause 0 m rms" in note for note in designed(ModulationResidual(), level).notes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("uses: [at_rest, printed, sixteen]", "uses: [printed, sixteen]", "none is without rotation"),
        ("segments: [align-*, at-rest, printed, sixteen]", "segments: [align-*, printed, sixteen]", "lacks 'at-rest'"),
        (
            "uses: [at_rest, printed, sixteen]",
            "uses: [at_rest, printed, again]",
            "at_rest and again are without rotation",
        ),
    ],
)
def test_check_says_which_navigation_is_missing(tmp_path: Path, old: str, new: str, words: str) -> None:
    plan = (Path(__file__).resolve().parents[2] / "plans" / "rotation_stop_navigation.yaml").read_text(encoding="utf-8")
    again = "  again: {estimator: strapdown_navigation, segments: [warm-up, align-at-rest, at-rest]}\n  rotation:\n"
    path = tmp_path / "plan.yaml"
    path.write_text(plan.replace("  rotation:\n", again).replace(old, new), encoding="utf-8")
    (finding,) = check_plan(path).findings.errors
    assert finding.code == "physics-modulation"
    assert words in finding.message


def test_a_plan_for_most_of_a_year_costs_no_more_to_check_than_one_for_a_day(tmp_path: Path) -> None:
    day = Path(__file__).resolve().parents[2] / "plans" / "rotation_stop_navigation.yaml"
    year = tmp_path / "year.yaml"
    plan = day.read_text(encoding="utf-8")
    year.write_text(plan.replace("cycles: 1, at_least: 24 h", "cycles: 2000"), encoding="utf-8")
    assert check_plan(day).ok and check_plan(year).ok  # and what is made once is there
    assert calls(lambda: check_plan(year)) < 1.5 * calls(lambda: check_plan(day))
