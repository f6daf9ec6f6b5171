"""Effects of the catalogue that serve simulations and estimates, from recordings of the independent generator."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from effects_within import GYRO, SITE, World, rates, rocks, single, statics, timed, truth

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.summaries import summarised
from planrunner.base import plugins
from planrunner.error_model.segment_columns import estimable
from planrunner.estimators.interface import Estimate
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.instruments.interfaces import Block, SummaryChannels
from planrunner.observation.samples import observed
from tests.blind.device import clean_output, ideal

G = 9.80665
ROCKED = timed([*statics(4.0), *rates(50, seconds=3.6), *rocks((8, 0.5), (2, 4), seconds=4.3)])


def away(found: Estimate, name: str, true: float) -> float:
    one = found[name]
    return abs(one.value - true) / one.standard_uncertainty


def test_a_response_to_angular_acceleration() -> None:
    outputs = {"gyro_x": (*GYRO, "gyro_angular_acceleration")}
    world = World(ROCKED, single("gyro_angular_acceleration", 2e-3, -1e-3, 3e-3), outputs, basis="within_segment")
    found = world.estimate(1)
    assert found["gyro_angular_acceleration_x"].unit == "ms" and away(found, "gyro_angular_acceleration_x", 2.0) < 4
    assert found["gyro_angular_acceleration_x"].standard_uncertainty < 0.2


def test_an_output_folds_over_as_in_the_generator() -> None:
    turns = timed([*statics(3.0), *rates(50, 150, 200, seconds=2.0)])
    world = World(turns, single("gyro_fold_over", 170.0), {})
    (whole,) = (
        plugins.load(plugins.EFFECTS, "gyro_fold_over")()
        .at(observed(world.recording(1), SITE, world.model), 170.0)
        .columns
    )
    folded, plain = (
        clean_output(world.schedule, world.sensor, ideal(world.sensor), faults) for faults in (world.faults, {})
    )
    for axis in range(3):
        change = folded[:, axis] - plain[:, axis]
        assert np.abs(change).max() == pytest.approx(340.0)
        assert np.abs(np.degrees(whole.parts[axis]) * whole.segments[world.schedule.index] - change).max() < 1e-6


def test_accelerometers_that_warm_up() -> None:
    still = timed([one for _ in range(6) for one in statics(4.0)], begin=30.0, pause=40.0)
    outputs = {"accel_x": ("accel_bias", "accel_scale_factor", "accel_misalignment", "accel_warm_up")}
    found = World(still, single("accel_warm_up", 0.1, 0.05, -0.1, shape=(400.0,)), outputs).estimate(1)
    assert away(found, "accel_warm_up_tau_x", 400.0) < 4 and away(found, "accel_warm_up_a_x", 0.1 / G * 1e3) < 4


def test_a_warm_up_is_found_in_a_table_that_contains_only_means() -> None:
    still = timed([one for _ in range(6) for one in statics(4.0)], begin=30.0, pause=40.0)
    outputs = {"accel_x": ("accel_bias", "accel_scale_factor", "accel_misalignment", "accel_warm_up")}
    world = World(still, single("accel_warm_up", 0.1, 0.05, -0.1, shape=(400.0,)), outputs)
    found = world.estimate_of([_summarised(one) for one in world.recording(1)])
    assert away(found, "accel_warm_up_tau_x", 400.0) < 4 and away(found, "accel_warm_up_a_x", 0.1 / G * 1e3) < 4


def _summarised(recorded: RecordedSegment) -> RecordedSegment:
    """The segment as a row of a table: means, standard deviations, number of samples and duration."""
    own = recorded.statistics
    row = dict(zip(own.channels, own.mean, strict=True))
    row |= {f"s_{name}": float(own.covariance[k, k] ** 0.5) for k, name in enumerate(own.channels)}
    row |= {"n": float(own.count), "seconds": own.duration}
    block = Block(np.array([own.start]), {name: np.array([value]) for name, value in row.items()})
    summary = SummaryChannels({name: f"s_{name}" for name in own.channels}, "n", "seconds")
    return summarised(recorded.segment, recorded.units, summary, iter([block]), "table.csv")


@pytest.mark.parametrize(
    ("effect", "sizes"), [("gyro_bias_step", (0.02, -0.01, 0.03)), ("accel_bias_step", (0.02, 0.01, -0.02))]
)
def test_the_time_of_a_step_is_found_if_the_effect_is_named(effect: str, sizes: tuple[float, float, float]) -> None:
    segments = timed([*statics(6.0), *rates(20, seconds=5.0), *statics(6.0)])
    at = segments[8].start - 3.0  # in the pause before the ninth segment
    world = World(segments, single(effect, *sizes, shape=(at,)), {})
    seen = observed(world.recording(1), SITE, world.model)
    found = diagnose(seen, DiagnosisOptions(effects=(effect, "gyro_bias_random_walk", "gyro_warm_up")))
    assert found.verdict.effects == (effect,)
    by_name = {one.name: one for one in found.parameters}
    before, after = segments[7].start + segments[7].duration, segments[8].start
    assert before - 0.1 <= by_name["time"].value <= after + 0.1
    factor = 1.0 if effect.startswith("gyro") else 1e3 / G
    step = by_name["s_x"]
    assert abs(step.value - sizes[0] * factor) < 4 * step.standard_uncertainty


def test_an_effect_that_is_no_hypothesis_can_be_given() -> None:
    segments = timed([*statics(6.0), *rates(20, seconds=5.0), *statics(6.0)])
    world = World(segments, single("gyro_bias_step", 0.02, 0.0, 0.0, shape=(segments[8].start - 3.0,)), {})
    seen = observed(world.recording(2), SITE, world.model)
    found = diagnose(seen, DiagnosisOptions(effects=("gyro_warm_up",), given=("gyro_bias_step",)))
    assert found.verdict.kind == "none" and {one.effect for one in found.given} == {"gyro_bias_step"}


def test_a_step_is_refused_by_an_estimate_and_hysteresis_is_not() -> None:
    step, loop = (plugins.load(plugins.EFFECTS, name)() for name in ("gyro_bias_step", "accel_thermal_hysteresis"))
    assert "its shape parameter (time)" in estimable(step) and not estimable(loop)


def test_hysteresis_of_accelerometers_follows_the_last_change() -> None:
    from tests.gap.turntable import record

    seen = record()
    (variant,) = plugins.load(plugins.EFFECTS, "accel_thermal_hysteresis")().variants(seen)
    warm = [seen.temperature[part].mean() for part in seen.segments()]
    last = [0.0]
    for before, now in pairwise(warm):
        last.append(float(np.sign(now - before)) or last[-1])
    assert [c.name for c in variant.columns] == ["h_x", "h_y", "h_z"]
    for axis, column in enumerate(variant.columns):
        assert np.array_equal(column.parts[3 + axis], np.repeat(last, np.diff(seen.bounds)))


@pytest.mark.parametrize(
    ("effect", "sizes", "amplitude", "unit"),
    [
        ("gyro_vibration_rectification", (3e-5, -2e-5, 4e-5), "gyro_vibration_rectification_x", 1.0),
        ("gyro_axis_delay", (3e-4, -2e-4, 1e-4), "gyro_axis_delay_x", 1e-3),
    ],
)
def test_amplitudes_that_only_rocking_shows(
    effect: str, sizes: tuple[float, float, float], amplitude: str, unit: float
) -> None:
    world = World(ROCKED, single(effect, *sizes), {"gyro_x": (*GYRO, effect)}, basis="within_segment")
    found = world.estimate(1)
    assert away(found, amplitude, sizes[0] / unit) < 4
    assert found[amplitude].standard_uncertainty < 0.2 * sizes[0] / unit


def test_a_large_delay_of_an_axis_leaves_its_scale_factor_alone() -> None:
    """3 ms at 4 Hz weaken nothing, but the first two terms of the series in the delay differ by 0.3 %, which is not an error of the scale
    factor. The device has errors of the scale factor and misalignments of some 0.3 %."""
    outputs = {"gyro_x": (*GYRO, "gyro_axis_delay")}
    world = World(ROCKED, single("gyro_axis_delay", 3e-3, -2e-3, 1e-3), outputs, basis="within_segment", noisy=0.1)
    found, true = world.estimate(1), truth(world, 1)
    assert away(found, "gyro_axis_delay_x", 3.0) < 4
    assert away(found, "gyro_scale_factor_x", true["gyro_scale_factor_x"]) < 4


def test_a_delay_of_an_output_delays_its_misaligned_inputs() -> None:
    """Misalignments of some 5 %, and noise far below what the delay changes in the input across the axis."""
    outputs = {"gyro_x": (*GYRO, "gyro_axis_delay")}
    delays = single("gyro_axis_delay", 3e-3, -2e-3, 1e-3)
    world = World(ROCKED, delays, outputs, basis="within_segment", noisy=0.01, spread=0.05)
    found, true = world.estimate(1), truth(world, 1)
    assert away(found, "gyro_axis_delay_x", 3.0) < 4
    for name in ("gyro_scale_factor_x", "gyro_misalignment_towards_y_x", "gyro_misalignment_towards_z_x"):
        assert away(found, name, true[name]) < 4


def test_a_bias_behind_the_thermometer() -> None:
    """Ramps of 20 K in 400 s and rests between, against Euler's rule in steps of 20 ms."""
    from recorded import from_samples

    from planrunner.estimators.error_model.estimator import ErrorModelEstimator
    from planrunner.estimators.error_model.parameters import ErrorModelParameters
    from planrunner.estimators.interface import EstimateRequest
    from planrunner.plan import schedule as planned

    tau, c, bias, celsius = 150.0, 2e-3, 0.01, (25.0, 45.0, 45.0, 25.0, 5.0, 5.0, 5.0, 25.0, 25.0)
    starts = np.arange(8) * 410.0
    begin, end = np.array(celsius[:-1]), np.array(celsius[1:])
    clock = np.arange(0.0, 8 * 410.0, 0.02)
    number = np.minimum(np.floor(clock / 410.0).astype(int), 7)
    warm = begin[number] + (end - begin)[number] * np.minimum((clock - starts[number]) / 400.0, 1.0)
    body, value = np.empty(len(clock)), warm[0]
    for place, now in enumerate(warm):
        body[place] = value
        value += 0.02 / tau * (now - value)
    draw, recorded = np.random.default_rng(4), []
    for k, start in enumerate(starts):
        time = start + np.arange(0.0, 400.0, 0.1)
        rate = bias + c * np.interp(time, clock, body - warm) + 5e-3 * draw.standard_normal(len(time))
        segment = planned.Segment(
            k, f"T{k}", np.eye(3), "", planned.Rest(), 400.0, temperature=celsius[k] + 273.15, start=float(start),
            ramp_to=celsius[k + 1] + 273.15 if celsius[k + 1] != celsius[k] else None,
        )  # fmt: skip
        recorded.append(from_samples(segment, time, {"gyro_x": rate}, {"gyro_x": "deg/s"}))
    outputs: dict[str, tuple[str, ...]] = {"gyro_x": ("gyro_bias", "gyro_bias_temperature_lagged")}
    world = World([], {}, {})
    request = EstimateRequest("model", tuple(recorded), ErrorModelParameters(outputs=outputs), SITE, world.model)
    found = ErrorModelEstimator().estimate(request)
    assert away(found, "gyro_bias_temperature_lagged_c_x", c) < 4
    assert away(found, "gyro_bias_temperature_lagged_tau_x", tau) < 4
    assert found["gyro_bias_temperature_lagged_tau_x"].standard_uncertainty < 0.1 * tau
