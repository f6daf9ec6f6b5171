"""A segment in another state than planned, and means that an earlier program removed, are named; effects and noise are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.base.findings import Findings
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.recording_checks import check_segments, other_state, removed_means
from planrunner.plan.schedule import Motion, Rest, Rock, Spin
from tests.gap import turntable
from tests.gap.turntable import DEG, Array, G, record


def turned(observed: Observed, segment: int, degrees: float) -> Observed:
    """What the plan says of one segment, turned about the horizontal sensor axis that follows; the samples stay."""
    attitude = observed.attitude.copy()
    axis = np.eye(3)[int(np.argmin(np.abs(attitude[segment][:, 2])))]
    attitude[segment] = Rotation.from_rotvec(degrees * DEG * axis).as_matrix() @ attitude[segment]
    return replace(observed, attitude=attitude)


@pytest.mark.parametrize(("segment", "degrees"), [(1, 180.0), (4, 180.0), (6, 90.0), (9, 20.0)])
def test_a_segment_in_another_orientation_is_named(segment: int, degrees: float) -> None:
    log = Findings()
    check_segments(turned(record(), segment, degrees), "recording", log)
    (found,) = [one for one in log if one.code == "gap-other-state"]
    assert (
        f"in 'S{segment}', the accelerometers show a direction of gravity that deviates by {degrees:.3g} deg"
        in found.message
    )


def test_a_segment_that_turned_the_other_way_is_named() -> None:
    observed = record()
    one = next(k for k, motion in enumerate(observed.motions) if isinstance(motion, Spin) and motion.rate > 1.0)
    motions = list(observed.motions)
    motions[one] = Spin(-motions[one].rate)  # type: ignore[union-attr]
    rows = observed.segments()[one]
    rate, angle = observed.rate.copy(), observed.angle.copy()
    rate[rows], angle[rows] = -rate[rows], -angle[rows]
    log = Findings()
    check_segments(replace(observed, motions=tuple(motions), rate=rate, angle=angle), "recording", log)
    (found,) = [item for item in log if item.code == "gap-other-state"]
    assert f"in 'S{one}', the gyros show a rate in the opposite sense" in found.message


def test_effects_and_noise_are_no_other_state() -> None:
    def shocked(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array]:
        """A bias in the fourth segment alone, of a size that changes the magnitude."""
        here = (observed.owner == 3)[:, None]
        return 5 * DEG * here * np.ones(3), 0.2 * G * here * force / G

    def asymmetric(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 0.01 * np.abs(omega), 0.0

    for fault in (None, asymmetric, shocked):
        observed = record(seed=3, fault=fault)
        assert other_state(observed) is None
        assert removed_means(observed) == ()


def test_removed_means_are_named() -> None:
    """Gyros at rest whose means are removed, one of them with a spike that the diagnosis leaves out again."""
    whole = record()
    values = whole.values.copy()
    for part, motion in zip(whole.segments(), whole.motions, strict=True):
        if isinstance(motion, Rest):
            values[part, :3] -= values[part, :3].mean(axis=0)
            values[part.start, 0] += 2.0 * values[part, 0].std()
    assert set(removed_means(replace(whole, values=values))) >= {"gyro_y", "gyro_z"}
    log = Findings()
    check_segments(replace(whole, values=values), "recording", log)
    assert [one.code for one in log] == ["gap-means-removed"]


def test_white_noise_around_zero_is_no_removed_mean() -> None:
    """An ideal gyro: 40 recordings of noise around zero."""
    whole = record()
    draw = np.random.default_rng(5)
    for _ in range(40):
        assert removed_means(replace(whole, values=draw.normal(size=whole.values.shape))) == ()


def test_rocking_is_no_removed_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nearly all segments rock, and the means of whole periods are nearly zero."""
    upright = np.eye(3)
    frequencies = (0.8, 0.85, 0.9, 1.0, 1.1, 1.2, 1.25, 1.3)
    rows: list[tuple[Array, Motion, float, float]] = [
        (upright, Rock(5 * DEG, frequency, (0.0,), 20.0), 20.0, 25.0) for frequency in frequencies
    ]
    rows.append((upright, Rest(), 20.0, 25.0))
    monkeypatch.setattr(turntable, "plan", lambda: rows)
    for seed in range(4):
        assert removed_means(record(seed=seed)) == ()


@pytest.mark.parametrize("frequency", [5.0, 5.03, 5.05, 0.3])
@pytest.mark.parametrize("gain", [1.0, 0.05])
def test_a_vibration_is_no_removed_mean(frequency: float, gain: float) -> None:
    """Rests on a vibrating table: whole periods have no mean, and those of 5.05 Hz have one in each half. With the small gain, the
    biases are 0.001 deg/s, much smaller than the vibration of 2 deg/s."""
    for seed in range(3):
        whole = record(seed=seed)
        rests = [k for k, motion in enumerate(whole.motions) if isinstance(motion, Rest)]
        observed = turntable.kept(whole, rests)
        gyros = observed.values[:, :3].copy()
        gyros -= (1 - gain) * gyros.mean(axis=0)
        gyros += 2 * DEG * np.sin(2 * np.pi * frequency * observed.time)[:, None]
        values = np.column_stack([gyros, observed.values[:, 3:]])
        assert removed_means(replace(observed, values=values)) == ()


def test_accelerometers_across_a_horizontal_axis_have_no_removed_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gravity turns through their input axes, and has no mean over whole turns."""
    rows: list[tuple[Array, Motion, float, float]] = [
        (np.eye(3), Spin(sign * rate * DEG, (0.0, 1.0, 0.0)), 20.0, 25.0)
        for rate in (18, 36, 54, 72, 90)
        for sign in (1, -1)
    ]
    monkeypatch.setattr(turntable, "plan", lambda: rows)
    observed = record(seed=1)
    draw = np.random.default_rng(1)
    omega, force = observed.omega, observed.force
    values = np.hstack([omega + 0.02 * DEG, force + 0.02]) + draw.normal(0, 1e-3, observed.values.shape)
    assert np.ptp(force[:, 0]) > G
    assert removed_means(replace(observed, values=values)) == ()
