"""The estimator: its figures on simulated recordings against theory, its definitions by hand, and its uncertainties by repetition."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorded import figure, from_samples
from standing_unit import DEG_H, RATE, SITE, recorded, request, samples, sensor

from planrunner.estimators import method
from planrunner.estimators.interface import DesignRequest, Estimate, Setup
from planrunner.estimators.method import designed
from planrunner.estimators.stated_errors import stated_site
from planrunner.estimators.strapdown.navigating import StrapdownNavigationParameters
from planrunner.estimators.strapdown.navigation_errors import CEP_INTERVAL, CEP_SHARE, CEP_SPREAD, stride
from planrunner.estimators.strapdown.strapdown_navigation import StrapdownNavigation
from planrunner.physics.earth import Site
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Cycle, Move
from planrunner.uncertainty.conditions import influences_on
from planrunner.uncertainty.influences import InputQuantity, Inputs

EARTH = SITE.earth_rate
RADIUS = 6_378_137.0


def navigated(errors: tuple[float, ...], seconds: float = 3 * 3600, noise: float = 1e-4, **parameters: Any) -> Estimate:
    """Alignment of 10 min without constant errors, then navigation with them, so that theory needs no alignment error."""
    stop = recorded("align", samples(600, noise=noise), 100.0)
    run = recorded("navigate", samples(seconds, errors=errors, noise=noise, seed=1), 700.0)
    return StrapdownNavigation().estimate(request(stop, run, **parameters))


@pytest.mark.slow
def test_accelerometer_error_is_a_schuler_oscillation() -> None:
    """50 µg to the north: ∇/ω²·(1 − cos ωt), 2·50 µg·R = 640 m at most, half of a Schuler period after the start. The plane of the
    oscillation turns with Ω·sin L, as Foucault's; what is left out is of the order (Ω/ω)² = 0.4 %."""
    found = navigated((0, 0, 0, 0, 50, 0), noise=1e-6)
    north = np.array(found.extra["north_m"])
    time = np.array(found.extra["time_s"])
    natural = math.sqrt(SITE.gravity / 6_367_000)
    within = time < 5000
    wanted = 50e-6 * 9.80665 / natural**2 * (1 - np.cos(natural * time) * np.cos(EARTH * np.sin(SITE.latitude) * time))
    assert np.abs(north - wanted)[within].max() < 15
    assert found["largest_radial_error"].value == pytest.approx(2 * 50e-6 * 6_367_000, rel=0.05)


def test_drift_is_so_many_miles_an_hour() -> None:
    """0.01 deg/h of a gyro that points east: over three hours near 0.6 nmi/h to the south, by the slope through the origin."""
    found = navigated((0.01, 0, 0, 0, 0, 0))
    time, east, north = (np.array(found.extra[name]) for name in ("time_s", "east_m", "north_m"))
    radial = np.hypot(east, north)
    assert north[-1] < -2000
    slope = float(time @ radial / (time @ time)) * 3600 / 1852
    assert found["radial_error_rate"].value == pytest.approx(slope, rel=1e-3)
    assert found["radial_error_rate"].value == pytest.approx(0.6, rel=0.15)
    assert found["cep_rate"].value == pytest.approx(found["radial_error_rate"].value * math.sqrt(math.log(2)))
    assert found["radial_error"].value == pytest.approx(
        math.hypot(found["east_error"].value, found["north_error"].value)
    )
    assert found["radial_error"].value == pytest.approx(radial[-1], rel=1e-6)
    assert found["rms_radial_error"].value == pytest.approx(math.sqrt(np.mean(radial**2)), rel=2e-2)


def test_figures_of_one_run_for_a_cep() -> None:
    """χ² with two degrees of freedom from its own table: 0.0506 and 7.378 at 2.5 and 97.5 %."""
    assert math.sqrt(2 / 7.3778) == pytest.approx(CEP_INTERVAL[0], rel=1e-4)
    assert math.sqrt(2 / 0.050636) == pytest.approx(CEP_INTERVAL[1], rel=1e-4)
    draw = np.random.default_rng(2).standard_normal((100_000, 2))
    radial = np.hypot(*draw.T)
    assert np.median(radial) == pytest.approx(CEP_SHARE * math.sqrt(np.mean(radial**2)), rel=0.01)
    one_run = CEP_SHARE * radial
    true = CEP_SHARE * math.sqrt(2)
    covered = np.mean((one_run * CEP_INTERVAL[0] <= true) & (true <= one_run * CEP_INTERVAL[1]))
    assert covered == pytest.approx(0.95, abs=0.003)
    assert np.diff(np.quantile(true / one_run, [0.1586553, 0.8413447]))[0] / 2 == pytest.approx(CEP_SPREAD, rel=0.02)


def test_whole_hours_are_on_the_course() -> None:
    for knots in (500, 7200, 86_400, 259_200):
        step = stride(knots)
        assert knots / step <= 2000
        assert 3600 % step == 0
    found = navigated((0.01, 0, 0, 0, 0, 0), seconds=2 * 3600)
    assert len(found.extra["time_s"]) <= 2001
    assert found.extra["time_s"][0] == 0.0
    assert np.allclose(np.diff(found.extra["time_s"]), found.extra["time_s"][1])
    assert found.extra["duration_s"] == pytest.approx(7200)
    assert [row[0] for row in found.tables[0].rows][:2] == pytest.approx([1 / 6, 2 / 6])
    assert all(plot.lines for plot in found.plots)


def test_blocks_of_the_recording_change_no_bit() -> None:
    def run(rows: int) -> Estimate:
        stop = recorded("align", samples(600, noise=0.001), 100.0, rows=rows)
        moving = recorded("navigate", samples(1800, noise=0.001, seed=1), 700.0, rows=rows)
        return StrapdownNavigation().estimate(request(stop, moving))

    first, second = run(997), run(64)
    assert first.extra == second.extra
    assert [item.value for item in first.coefficients] == [item.value for item in second.coefficients]


def test_constant_errors_hide_behind_alignment() -> None:
    """A unit with a constant east drift, aligned with it, holds its place over the next hours: heading error and drift cancel."""
    errors = (0.02, 0, 0, 0, 0, 0)
    stop = recorded("align", samples(600, errors=errors, noise=1e-4), 0.0)
    run = recorded("navigate", samples(7200, errors=errors, noise=1e-4, seed=1), 600.0)
    gyro, accelerometer = parse_quantity("0.02 deg/h"), parse_quantity("20 ug")
    found = StrapdownNavigation().estimate(
        request(stop, run, gyro_uncertainty=gyro, accelerometer_uncertainty=accelerometer)
    )
    # heading is off by ε_E/(Ω·cos L), as its stated type B input says
    off = np.radians((found["heading"].value + 180) % 360 - 180)
    assert abs(off) == pytest.approx(0.02 * DEG_H / (EARTH * math.cos(SITE.latitude)), rel=0.02)
    acting = next(item for item in found.influences if "gyro" in item.quantity.name)
    assert math.sqrt(acting.covariance[0, 0]) == pytest.approx(np.degrees(abs(off)), rel=0.02)
    assert not acting.covariance[3:].any()
    assert found["radial_error"].value < 200
    with_heading = navigated(errors, seconds=7200)
    assert with_heading["radial_error"].value > 10 * found["radial_error"].value


@pytest.mark.slow
def test_uncertainties_cover_the_scatter_of_repetitions() -> None:
    """Errors at the end of 40 runs with noise alone, over their stated uncertainties: mean squares near one (χ², 99.9 %)."""
    from scipy.stats import chi2

    names = ("heading", "east_error", "north_error", "east_velocity_error", "north_velocity_error")
    ratios = []
    for seed in range(40):
        stop = recorded("align", samples(600, rate=2, noise=0.01, seed=seed), 0.0, rate=2)
        run = recorded("navigate", samples(3600, rate=2, noise=0.01, seed=1000 + seed), 600.0, rate=2)
        found = StrapdownNavigation().estimate(request(stop, run))
        values = [(found[name].value + 180) % 360 - 180 if name == "heading" else found[name].value for name in names]
        ratios.append([value / found[name].standard_uncertainty for name, value in zip(names, values, strict=True)])
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 40)
    for name, total in zip(names, np.sum(np.square(ratios), axis=0), strict=True):
        # the noise is known from 300 s of each run, 5 %, so that uncertainties scatter by that too
        assert 0.8 * low < total < 1.25 * high, name


def test_latitude_is_an_influence() -> None:
    """The error equations against the same samples navigated with the latitude moved: the general way, which a long navigation cannot take.
    The error equations leave the alignment of 10 min as it is."""
    inputs = Inputs({"latitude": InputQuantity("latitude", SITE.latitude, "rad", 1e-6)})
    stop, run = (
        recorded("align", samples(600, noise=1e-4), 0.0),
        recorded("navigate", samples(7200, noise=1e-4, seed=1), 600.0),
    )

    def results(site: Site) -> np.ndarray:
        return np.array(
            [one.value for one in StrapdownNavigation().estimate(request(stop, run, site=site)).coefficients]
        )

    (supplied,) = StrapdownNavigation().estimate(request(stop, run, setup=Setup(inputs=inputs))).influences
    (general,) = influences_on(results, stated_site(inputs, SITE))
    assert supplied.sensitivities[3:] == pytest.approx(general.sensitivities[3:], rel=0.2)
    plan = planned(run={"dwell": 7200.0}, noise=1e-4)
    without, stated = (
        {one.name: one.standard_uncertainty for one in designed(StrapdownNavigation(), asked).predicted}
        for asked in (plan, replace(plan, setup=Setup(inputs=inputs)))
    )
    for name, row in (("east_error", 3), ("north_error", 4)):
        added = math.sqrt(stated[name] ** 2 - without[name] ** 2)
        assert added == pytest.approx(1e-6 * abs(general.sensitivities[row, 0]), rel=0.2)


def test_turning_modulates_what_stands_still_does_not() -> None:
    """Half turns every 5 min; the alignment is free of the errors. What turning leaves is a small share."""
    errors = (0.02, -0.02, 0, 50, 50, 0)
    rate, stop_seconds = RATE, 291.0
    turn = np.radians(np.arange(1, 181))  # 18 s at 10 deg/s and 10 Hz
    one = np.concatenate(
        [np.zeros(round(stop_seconds * rate)), turn, np.full(round(stop_seconds * rate), np.pi), np.pi - turn]
    )
    angle = np.concatenate([[0.0], np.tile(one, 12)])
    cycle = Cycle({"A": 0.0, "C": np.pi}, (Move("A", np.pi, "C"), Move("C", -np.pi, "A")), np.radians(10), stop_seconds)
    stop = recorded("align", samples(600, noise=1e-4), 0.0)
    seconds = (len(angle) - 1) / rate
    turned = recorded("navigate", samples(seconds, angle=angle, errors=errors, noise=1e-4, seed=1), 600.0, motion=cycle)
    still = recorded("navigate", samples(seconds, errors=errors, noise=1e-4, seed=1), 600.0)
    with_turns = StrapdownNavigation().estimate(request(stop, turned))
    without = StrapdownNavigation().estimate(request(stop, still))
    assert with_turns["rms_radial_error"].value < 0.15 * without["rms_radial_error"].value


def test_alignment_in_a_cycle_determines_constant_errors() -> None:
    """Stops of 100 s at 0 and 180 deg: the table of constant errors holds the horizontal ones, and heading is not off by ε_E/(Ω·cos φ)."""
    errors = (0.02, -0.01, 0, 40, -30, 0)
    turn = np.radians(np.arange(1, 181))
    one = np.concatenate([np.zeros(1000), turn, np.full(1000, np.pi), np.pi - turn])
    angle = np.concatenate([[0.0], np.tile(one, 4)])
    cycle = Cycle({"A": 0.0, "C": np.pi}, (Move("A", np.pi, "C"), Move("C", -np.pi, "A")), np.radians(10), 100.0)
    stop = recorded(
        "align", samples((len(angle) - 1) / RATE, angle=angle, errors=errors, noise=1e-4), 0.0, motion=cycle
    )
    run = recorded("navigate", samples(1800, errors=errors, noise=1e-4, seed=1), stop.statistics.end)
    found = StrapdownNavigation().estimate(request(stop, run))
    heading = (found["heading"].value + 180) % 360 - 180
    assert abs(heading) < 3 * found["heading"].standard_uncertainty < 0.05
    rows = {row[0]: [figure(cell) for cell in row[1:3]] for row in found.tables[1].rows}
    for name, value in (("gyro_x", 0.02), ("gyro_y", -0.01), ("accel_x", 40), ("accel_y", -30)):
        assert abs(rows[name][0] - value) < 3 * rows[name][1], name
    assert rows["gyro_x"][1] < 0.002
    # A gyro that is misaligned to the turning axis tilts the attitude in turning just as an accelerometer error does from stop to stop:
    # the two are told apart only as far as misalignment is taken to be small, 1e-4 rad or 100 µg.
    assert rows["accel_x"][1] == pytest.approx(100, rel=0.02)


def test_increments_and_other_units_give_the_same() -> None:
    channels, run = samples(600, noise=0.001), samples(1800, noise=0.001, seed=1)
    first = StrapdownNavigation().estimate(request(recorded("align", channels, 0.0), recorded("navigate", run, 600.0)))
    factor = {"gyro": np.pi / 180 / 3600 / RATE, "acce": 9.80665 / RATE}
    units = {name: "rad" if name.startswith("gyro") else "m/s" for name in channels}
    as_increments = [
        recorded(label, {name: values * factor[name[:4]] for name, values in data.items()}, start, more_units=units)
        for label, data, start in (("align", channels, 0.0), ("navigate", run, 600.0))
    ]
    second = StrapdownNavigation().estimate(request(*as_increments))
    for one, other in zip(first.coefficients, second.coefficients, strict=True):
        assert one.value == pytest.approx(other.value, rel=1e-6, abs=1e-7)


def test_a_carrier_is_held_against_its_reference() -> None:
    """Along the parallel at 10 m/s after a stop: the reference says where it is, and nothing is left but noise."""
    rate, speed, n = RATE, 10.0, 18_000
    parallel = (RADIUS / math.sqrt(1 - 0.00669437999014 * math.sin(SITE.latitude) ** 2) + SITE.height) * math.cos(
        SITE.latitude
    )
    transport = speed / parallel * np.array([0.0, math.cos(SITE.latitude), math.sin(SITE.latitude)])
    earth = EARTH * np.array([0.0, math.cos(SITE.latitude), math.sin(SITE.latitude)])
    force = np.cross(2 * earth + transport, [speed, 0, 0]) + np.array([0, 0, SITE.gravity])
    level = np.concatenate([(earth + transport) / DEG_H, force / 9.80665])
    noise = samples(n / rate, noise=1e-4, seed=1)
    quiet = samples(n / rate)
    time = np.arange(1, n + 1) / rate
    moving = {name: level[k] + noise[name] - quiet[name] for k, name in enumerate(quiet)}
    reference = {
        "reference_latitude": np.full(n, math.degrees(SITE.latitude)),
        "reference_longitude": np.degrees(SITE.longitude + speed * time / parallel),
        "reference_height": np.full(n, SITE.height),
        "reference_velocity_east": np.full(n, speed),
        "reference_velocity_north": np.zeros(n),
    }
    units = dict.fromkeys(("reference_latitude", "reference_longitude"), "deg")
    units |= {"reference_height": "m", "reference_velocity_east": "m/s", "reference_velocity_north": "m/s"}
    stop = recorded("align", samples(600, noise=1e-4), 0.0)
    run = recorded("navigate", {**moving, **reference}, 600.0, more_units=units)
    found = StrapdownNavigation().estimate(request(stop, run))
    assert found["radial_error"].value < 4 * found["radial_error"].standard_uncertainty + 1
    assert found["radial_error"].value < 100
    assert found["largest_velocity_error"].value < 0.1


def test_short_gaps_are_bridged_and_reported() -> None:
    channels = samples(1800, noise=1e-5, seed=1)
    stop = recorded("align", samples(600, noise=1e-5), 0.0)
    whole = StrapdownNavigation().estimate(request(stop, recorded("navigate", channels, 600.0)))
    run = recorded("navigate", channels, 600.0)
    kept = np.delete(np.arange(18_000), [0, 5000, 9971])
    time = 600.0 + np.arange(1, 18_001)[kept] / RATE
    gappy = from_samples(run.segment, time, {name: values[kept] for name, values in channels.items()}, run.units)
    found = StrapdownNavigation().estimate(request(stop, gappy))
    assert any("3 missing samples" in warning for warning in found.warnings)
    assert found["radial_error"].value == pytest.approx(whole["radial_error"].value, abs=1.0)


def test_position_is_that_stated_for_the_run() -> None:
    told = Setup(information={"initial_latitude": "-33.5", "initial_longitude": "18.25 deg", "initial_height": "35"})
    south = replace(SITE, latitude=math.radians(-33.5), height=35.0)
    stop = recorded("align", samples(600, noise=1e-4, site=south), 0.0)
    run = recorded("navigate", samples(1800, noise=1e-4, seed=1, site=south), 600.0)
    found = StrapdownNavigation().estimate(request(stop, run, setup=told, gravity="wgs84"))
    assert found.settings["start_latitude"].startswith("-33.5")
    assert found.settings["start_longitude"].startswith("18.25")
    assert found["radial_error"].value < 50


# -- before the run ----------------------------------------------------------------------------------------------------


def planned(
    parameters: StrapdownNavigationParameters | None = None,
    site: Site = SITE,
    noise: float = 0.01,
    stop: dict[str, Any] | None = None,
    run: dict[str, Any] | None = None,
) -> DesignRequest:
    """stop, run: what is different of the segments."""
    aligned = recorded("align", samples(10), 0.0).segment
    navigated = recorded("navigate", samples(10), 0.0).segment
    segments = (
        replace(aligned, **{"dwell": 600.0, "index": 0, **(stop or {})}),
        replace(navigated, **{"dwell": 3 * 3600.0, "index": 1, **(run or {})}),
    )
    return DesignRequest("free", segments, parameters or StrapdownNavigationParameters(), site, sensor(noise))


@pytest.mark.slow
def test_expected_errors_are_those_of_repetitions() -> None:
    """The design's root mean squares against 30 simulated units with random constant errors and noise: within their scatter of 13 %."""
    stated = StrapdownNavigationParameters(
        gyro_uncertainty=parse_quantity("0.02 deg/h"), accelerometer_uncertainty=parse_quantity("40 ug")
    )
    expected = method.designed(StrapdownNavigation(), planned(parameters=stated))
    draw, found = np.random.default_rng(5), []
    for seed in range(30):
        errors = tuple(draw.normal(0, 1, 6) * [0.02, 0.02, 0.02, 40, 40, 40])
        stop = recorded("align", samples(600, rate=2, errors=errors, noise=0.01, seed=seed), 0.0, rate=2)
        run = recorded("navigate", samples(3 * 3600, rate=2, errors=errors, noise=0.01, seed=500 + seed), 600.0, rate=2)
        one = StrapdownNavigation().estimate(request(stop, run))
        heading = (one["heading"].value + 180) % 360 - 180
        found.append([heading, one["east_error"].value, one["north_error"].value, one["radial_error"].value])
    predicted = {item.name: item.standard_uncertainty for item in expected.predicted}
    measured = np.sqrt(np.mean(np.square(found), axis=0))
    for name, value in zip(("heading", "east_error", "north_error", "radial_error"), measured, strict=True):
        assert value == pytest.approx(predicted[name], rel=0.45), name  # three times 13 %, and skew


def test_a_long_alignment_is_foreseen_in_coarser_knots_with_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    """To a tenth, as uncertainties are planned: coarser knots are fewer measurements of the same."""
    stated = StrapdownNavigationParameters(
        gyro_uncertainty=parse_quantity("0.02 deg/h"), accelerometer_uncertainty=parse_quantity("40 ug")
    )
    moves = (Move("A", np.pi, "B"), Move("B", -np.pi, "A"))
    turning = Cycle({"A": 0.0, "B": np.pi}, moves, math.radians(10), 120.0)
    for stop in ({"dwell": 10_000.0}, {"dwell": 20 * 276.0, "motion": turning}):
        plan = planned(parameters=stated, stop=stop)
        found = []
        for knots in (100_000, 1800):
            monkeypatch.setattr("planrunner.estimators.strapdown.design._KNOTS", knots)
            found.append(designed(StrapdownNavigation(), plan).predicted)
        for fine, coarse in zip(*found, strict=True):
            assert coarse.standard_uncertainty == pytest.approx(fine.standard_uncertainty, rel=0.1), fine.name


def test_names_foreseen_are_those_estimated() -> None:
    expected = [item.name for item in designed(StrapdownNavigation(), planned()).predicted]
    assert expected == [item.name for item in navigated((0,) * 6, seconds=600).coefficients]


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"stop": {"label": "warm-up"}}, "physics-navigation-align", "none of the segments is for alignment"),
        ({"run": {"label": "align-2"}}, "physics-navigation-align", "both for alignment"),
        (
            {"stop": {"motion": Cycle({"A": 0.0}, (Move("A", 2 * np.pi, "A"),), 0.2, 30.0)}},
            "physics-navigation-align",
            "is at rest for 30 s",
        ),
        ({"run": {"attitude": np.eye(3)[[1, 2, 0]]}}, "physics-navigation-gap", "does not begin in the orientation"),
        ({"run": {"sample_rate": 50.0}}, "physics-navigation-rate", "different sample rates"),
        ({"site": replace(SITE, latitude=math.radians(88))}, "physics-navigation-latitude", "88 deg"),
    ],
)
def test_plans_that_cannot_work_are_refused(changes: dict[str, Any], code: str, words: str) -> None:
    remarks = [item for item in method.designed(StrapdownNavigation(), planned(**changes)).remarks if item.error]
    assert [remark.code for remark in remarks if words in remark.message] == [code]


def test_cycles_beyond_a_gyros_full_scale_are_refused() -> None:
    """A cycle turns about the vertical, which the z axis feels and no other does."""
    turning = planned(run={"motion": Cycle({"A": 0.0}, (Move("A", 2 * np.pi, "A"),), math.radians(12), 30.0)})
    limits = {"gyro_x": 36_000.0, "gyro_y": 36_000.0, "gyro_z": 39_600.0}  # deg/h
    outputs = tuple(replace(item, full_scale=limits.get(item.name, math.inf)) for item in turning.sensor.outputs)
    design = designed(StrapdownNavigation(), replace(turning, sensor=replace(turning.sensor, outputs=outputs)))
    assert [(remark.code, remark.message.split(",")[0]) for remark in design.remarks if remark.error] == [
        ("physics-full-scale", "'gyro_z' would show 4.32e+04 deg/h in 'navigate'")
    ]


def test_doubtful_plans_are_remarked() -> None:
    design = planned(run={"motion": Cycle({"A": 0.0}, (Move("A", 2 * np.pi, "A"),), 1.0, 30.0)})
    short = replace(design, segments=(design.segments[0], replace(design.segments[1], dwell=1800.0)))
    codes = {remark.code for remark in designed(StrapdownNavigation(), short).remarks}
    assert codes == {"physics-navigation-short", "physics-navigation-rate"}
    assert not any(remark.error for remark in designed(StrapdownNavigation(), short).remarks)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_data_without_noise_are_aligned_with_the_uncertainty_that_their_errors_leave(
    noise: float, turned: bool
) -> None:
    """Nothing moved: gyros with constant errors of 0.05 deg/h and no noise, and an alignment contiguous with the navigation."""
    cycle = Cycle({"A": 0.0, "C": np.pi}, (Move("A", np.pi, "C"), Move("C", -np.pi, "A")), np.radians(10), 90.0)
    course = RotationCycle.of(cycle, math.inf)
    seconds = 8 * course.period if turned else 1800
    angle = course.angle(np.arange(round(seconds * RATE) + 1) / RATE) if turned else 0.0
    errors = (0.05, 0.05, 0.05, 50, 30, 10)
    stop = recorded("align", samples(seconds, angle=angle, errors=errors, noise=noise), 0.0)
    if turned:
        stop = replace(stop, segment=replace(stop.segment, motion=cycle, dwell=None))
    run = recorded("navigate", samples(900, errors=errors, noise=noise, seed=1), float(seconds))
    found = StrapdownNavigation().estimate(request(stop, run))
    off = (found["heading"].value + 180) % 360 - 180
    assert abs(off) < 3 * found["heading"].standard_uncertainty + 1e-3
    assert found["heading"].standard_uncertainty < 1.0
