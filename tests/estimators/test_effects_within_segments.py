"""Effects within segments from samples: what one recording gives, what is predicted, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from effects_within import GYRO, World, rates, rocks, single, statics, timed, truth
from recorded import from_samples

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.error_model.estimator import ErrorModelEstimator
from planrunner.estimators.error_model.within import errors_of_phase, known_in_batches
from planrunner.estimators.interface import EstimateRequest, EstimationError
from planrunner.estimators.method import designed
from planrunner.plan.schedule import Spin
from tests.blind.plans import Segment

SECONDS = 4.3  # of rocking
ROCKED = timed([*statics(6.0), *rates(50, seconds=3.6), *rocks((8, 0.5), (2, 4), seconds=SECONDS)])
LAG = World(
    ROCKED,
    single("gyro_bandwidth", 8e-3),
    {"gyro_x": (*GYRO, "gyro_bandwidth")},
    {"gyro_bandwidth": {"tau": "8 ms"}},
    basis="within_segment",
)


def test_a_lag_is_found_within_its_uncertainty_which_is_predicted() -> None:
    found = LAG.estimate(1)
    lag = found["gyro_bandwidth_tau_x"]
    assert lag.unit == "s" and abs(lag.value - 8e-3) < 3.5 * lag.standard_uncertainty
    # One rate signal of amplitude A at pulsation p, N samples of noise σ: its part behind by τ is τ·A·p in quadrature.
    ways = [(math.radians(8), 0.5), (math.radians(2), 4.0)]
    information = (
        sum(SECONDS * 50 / 2 * (math.degrees(a) * (2 * math.pi * f) ** 2) ** 2 for a, f in ways) / 0.01**2
    )  # the sensor's x is rocked once at each frequency
    assert lag.standard_uncertainty == pytest.approx(information**-0.5, rel=0.05)
    design = designed(ErrorModelEstimator(), LAG.design())
    planned = {one.name: one.standard_uncertainty for one in design.predicted}
    assert not design.remarks
    assert planned["gyro_bandwidth_tau_x"] == pytest.approx(information**-0.5, rel=0.05)
    assert set(planned) == {one.name for one in found.coefficients}
    effects = found.extra["effects"]
    assert isinstance(effects, dict) and effects["gyro_bandwidth"] == {"tau": f"{lag.value:.9g} s"}


def test_a_lag_is_not_shown_by_segments_that_do_not_rock() -> None:
    world = World(timed([*statics(), *rates(50)]), {}, LAG.outputs)
    with pytest.raises(EstimationError, match=r"does not act on gyro_x.*in these segments") as refused:
        designed(ErrorModelEstimator(), world.design())
    assert "rocking segments" in refused.value.hint and refused.value.key == "outputs.gyro_x"


def test_without_an_expected_shape_no_uncertainty_is_predicted() -> None:
    design = designed(ErrorModelEstimator(), World(ROCKED, {}, LAG.outputs).design())
    assert not design.predicted and {one.name for one in design.unpredicted} >= {"gyro_bandwidth_tau_x"}
    assert "expected of gyro_bandwidth" in design.unpredicted[0].why


@pytest.mark.slow
def test_a_delay_and_a_lag_about_one_frequency_are_not_separable() -> None:
    outputs = {"gyro_x": (*GYRO, "gyro_bandwidth", "time_latency")}
    expected = {"gyro_bandwidth": {"tau": "1 ms"}, "time_latency": {"delay": "1 ms"}}
    design = designed(ErrorModelEstimator(), World(ROCKED, {}, outputs, expected).design())
    u = {one.name: one.standard_uncertainty for one in design.predicted}
    alone = {one.name: one.standard_uncertainty for one in designed(ErrorModelEstimator(), LAG.design()).predicted}
    assert u["time_latency_delay"] > 20 * alone["gyro_bandwidth_tau_x"]


@pytest.mark.slow
def test_noise_that_is_slower_than_white_is_said() -> None:
    assert not any("coloured" in str(text) for text in LAG.estimate(2).warnings)
    slow = World(ROCKED, {**LAG.faults, **single("slow_sine_bias", 0.01, 0.01, 0.01, shape=(5.0, 0.3))}, LAG.outputs)
    assert any("coloured" in str(text) for text in slow.estimate(2).warnings)
    assert np.isfinite(slow.estimate(2).covariance).all()


def test_the_example_of_the_page_is_predicted() -> None:
    page = (Path(__file__).parents[2] / "docs/error-models.md").read_text(encoding="utf-8")
    text = page.partition("## Effects within segments")[2].partition("```yaml\n")[2].partition("```")[0]
    listed = yaml.safe_load(text)["estimates"]["model"]
    world = World(ROCKED, {}, listed["outputs"], listed["expected"])
    predicted = {one.name for one in designed(ErrorModelEstimator(), world.design()).predicted}
    assert predicted >= {"gyro_bandwidth_tau_x", "gyro_warm_up_tau_x", "lever_arm_r_y_accel_x"}


def test_vibration_rectification_needs_no_lever_arm_on_the_axis() -> None:
    """Whole periods of two intensities. An accelerometer away from the axis does not fit this model, which a warning states."""
    segments = timed([*statics(), *rocks((8, 0.5), (2, 4), seconds=8.0)])
    outputs = {"accel_x": ("accel_bias", "accel_scale_factor", "accel_misalignment", "accel_vibration_rectification")}
    shift = single("accel_vibration_rectification", 1e-4, 0.0, 0.0)
    one = World(segments, shift, outputs).estimate(2)
    found = one["accel_vibration_rectification_x"]
    assert found.value == pytest.approx(1e-4 / 9.80665 * 1e6, abs=4 * found.standard_uncertainty)
    assert found.standard_uncertainty < 0.01 * found.value and not one.warnings
    away = World(segments, shift | single("lever_arm", 0.03, -0.02, 0.04), outputs).estimate(2)
    assert [text for text in away.warnings if "the model is incomplete" in text]


SLOWLY = [*statics(), *rates(50, seconds=20.2), *rocks((1, 0.5), seconds=8.3)]
"""The table turns by a little less than three turns: the Earth's rate does not average out."""


def begun_anywhere(world: World, seed: int) -> list[RecordedSegment]:
    """Turning segments of one length that begin at any angle of a whole turn: the rest of each is cut off on both sides."""
    draw, found = np.random.default_rng([seed, 9]), []
    for item in world.recording(seed):
        motion, rows = item.segment.motion, item.statistics.count
        if not isinstance(motion, Spin):
            found.append(item)
            continue
        turn = round(2 * math.pi / abs(motion.rate) / item.statistics.duration * rows)
        first = int(draw.integers(0, turn))
        kept = slice(first, first + rows - turn)
        blocks = list(item.blocks(tuple(item.units)))
        time = np.concatenate([block.time for block in blocks])[kept]
        channels = {name: np.concatenate([block.channels[name] for block in blocks])[kept] for name in item.units}
        found.append(from_samples(item.segment, time, channels, item.units))
    return found


@pytest.mark.slow
def test_an_angle_that_nothing_shows_is_in_the_uncertainty() -> None:
    """If the angle counted as zero, the errors of the misalignments would be several times their standard uncertainties. If the Earth rate
    once per turn counted as noise, the errors of the lag would be 0.4 of theirs. 20 recordings: the root mean square of one has a standard
    deviation of 0.16."""
    outputs = {"gyro_x": (*GYRO, "gyro_bandwidth")}
    world, errors = World(timed(SLOWLY), single("gyro_bandwidth", 20e-3), outputs, noisy=0.2), []
    names = ("gyro_misalignment_towards_y_x", "gyro_misalignment_towards_z_x", "gyro_bandwidth_tau_x")
    for seed in range(20):
        recorded = tuple(begun_anywhere(world, seed))
        request = EstimateRequest("model", recorded, world.parameters, world.site, world.model)
        found, true = ErrorModelEstimator().estimate(request), truth(world, seed)
        assert not any("coloured" in str(text) or "white noise" in str(text) for text in found.warnings)
        errors.append([(found[name].value - true[name]) / found[name].standard_uncertainty for name in names])
    size = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (size > 0.6).all() and (size < 1.5).all()


@pytest.mark.parametrize(("moved", "named"), [(rates(50, seconds=20.2), 1), ([], 0)])
def test_a_budget_names_an_angle_that_nothing_shows(moved: list[Segment], named: int) -> None:
    segments = timed([*statics(), *moved, *rocks((8, 0.5), seconds=8.3)])
    found = World(segments, single("gyro_bandwidth", 20e-3), {"gyro_x": (*GYRO, "gyro_bandwidth")}).estimate(1)
    assert [one.quantity.name for one in found.influences].count("angle of the table") == named


def test_an_unknown_phase_has_the_moments_of_all_phases() -> None:
    """Two turning segments and one at rest, against the mean over random phases."""
    draw = np.random.default_rng(8)
    turning = [np.exp(1j * np.linspace(0.3, 2.0, 3)), np.zeros(1, dtype=complex), 2 * np.exp(1j * np.linspace(1, 8, 4))]
    phases = np.exp(1j * draw.uniform(0, 2 * np.pi, (40_000, 3)))
    errors = np.concatenate(
        [np.real(phase[:, None] * own) - own.real for phase, own in zip(phases.T, turning, strict=True)], axis=1
    )
    found = errors_of_phase(turning)
    assert found.shape == (5, 8)
    assert found.T @ found == pytest.approx(errors.T @ errors / len(errors), abs=0.1)
    assert errors_of_phase(turning[1:2]).shape == (0, 1)


@pytest.mark.parametrize(("turns", "columns"), [(1.0, 1), (3.0, 1), (0.7, 3)])
def test_whole_turns_in_each_batch_leave_nothing_to_fit_but_the_mean(turns: float, columns: int) -> None:
    """The batch means of an input once per turn are then zero, apart from rounding errors."""
    angle = 2 * np.pi * turns * np.arange(16 * 50 + 7) / 50
    found = known_in_batches(3e-4 * np.exp(1j * angle), 50)
    assert found.shape == (16, columns)
    assert known_in_batches(np.zeros(16 * 50, complex), 50).shape == (16, 1)
