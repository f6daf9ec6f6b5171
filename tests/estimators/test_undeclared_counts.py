"""Counts that the bench file does not declare: found from the samples, and named if the noise does not average them out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_samples, real, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.allan.allan_deviation import AllanDeviationParameters
from planrunner.estimators.analysis import analyse
from planrunner.estimators.interface import Estimate
from planrunner.estimators.repeatability import RepeatabilityParameters
from planrunner.estimators.scale_factor import ScaleFactorParameters
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel
from planrunner.observation.screening import screened
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Spin

SITE = Site(math.radians(47.0), 9.807, earth_rate=0.0)
RATES = (1.0, -1.0, 5.0, -5.0, 20.0, -20.0, 60.0, -60.0)


def on_a_table(seed: int, count: float, noise: float = 0.5) -> list[RecordedSegment]:
    """A gyro of 200 (pulse/s)/(deg/s) with a zero output of 3 pulse/s. count: pulse/s, 0 for none; noise: of a sample, pulse/s."""
    draw, found = np.random.default_rng(seed), []
    for number, rate in enumerate(RATES):
        time = 40.0 * number + np.arange(3000) / 100
        values = 200.0 * rate + 3.0 + noise * draw.standard_normal(3000)
        values = np.round(values / count) * count if count else values
        motion = Spin(math.radians(rate), (0.0, 0.0, 1.0))
        planned = segment(f"R{number}", np.eye(3), motion, 30.0)
        found.append(from_samples(planned, time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    return found


def made(
    estimator: str, parameters: Record, recording: list[RecordedSegment], noise: NoiseModel | None = None
) -> Estimate:
    spec = {"k": EstimateSpec(estimator=estimator, segments=("R*",), parameters=parameters)}
    results = analyse(spec, (), recording, SITE, sensor("gyro_z", noise=noise))
    assert not results.failures
    return results.estimates["k"]


def coarse(found: Estimate) -> list[str]:
    return [
        text for text in found.warnings if "counts of" in text or "multiples" in text or "all samples are equal" in text
    ]


def scale_factor(recording: list[RecordedSegment], noise: NoiseModel | None = None) -> Estimate:
    return made("scale_factor", ScaleFactorParameters(outputs=("gyro_z",)), recording, noise)


@pytest.mark.parametrize("count", [1.5, 4.0, 7.0])
def test_undeclared_counts_are_found_and_named(count: float) -> None:
    [text] = coarse(scale_factor(on_a_table(1, count)))
    assert f"too small for counts of {count:.4g} pulse/s" in text
    [same] = coarse(scale_factor(on_a_table(1, count), NoiseModel(resolution=count)))
    assert f"too small for counts of {count:.4g} pulse/s" in same


def test_segments_of_equal_samples_are_named() -> None:
    """With counts of 50 pulse/s, the zero output of 3 pulse/s disappears, and no sample scatters."""
    found = scale_factor(on_a_table(2, 50.0))
    assert abs(found["F0_gyro_z"].value - 3) > 1e6 * found["F0_gyro_z"].standard_uncertainty
    [text] = coarse(found)
    assert "within each segment, all samples are equal" in text


@pytest.mark.parametrize("count", [0.0, 0.1, 0.5])
def test_counts_that_the_noise_averages_out_give_no_warning(count: float) -> None:
    for seed in range(3, 6):
        assert not coarse(scale_factor(on_a_table(seed, count)))


def test_the_noise_coefficient_of_a_rounded_output_is_doubted() -> None:
    """The count is six times the noise of a sample: most samples repeat the one before, and N describes the rounding."""
    draw = np.random.default_rng(7)
    time = np.arange(60000) / 100
    values = np.round((0.4 + 0.5 * draw.standard_normal(60000)) / 3.0) * 3.0
    recording = [from_samples(segment("R", np.eye(3), None, 600.0), time, {"gyro_z": values}, {"gyro_z": "pulse/s"})]
    [text] = coarse(made("allan_deviation", AllanDeviationParameters(outputs=("gyro_z",)), recording))
    assert "too small for counts of 3 pulse/s" in text


def test_a_stuck_segment_beside_written_digits_is_no_coarse_count() -> None:
    """The file has four decimals, far below the noise; one segment is at the limit of the output."""
    recording = on_a_table(8, 1e-4)
    stuck = recording[6]
    values = {"gyro_z": np.full(3000, 10000.0)}
    recording[6] = from_samples(stuck.segment, 240.0 + np.arange(3000) / 100, values, {"gyro_z": "pulse/s"})
    assert not coarse(scale_factor(recording))


@pytest.mark.parametrize("noise", [0.02, 0.3, 1.0])
def test_counts_whose_rounding_errors_are_carried_over_give_no_warning(noise: float) -> None:
    """A counter of pulses: what is left of one sample is counted in the next, so the means are not rounded."""
    for seed in range(9, 13):
        recording = []
        for one in on_a_table(seed, 0.0, noise):
            values = np.concatenate([block.channels["gyro_z"] for block in one.blocks(("gyro_z",))])
            time = np.concatenate([block.time for block in one.blocks(("gyro_z",))])
            counted = 4.0 * np.diff(np.floor(np.cumsum(values) / 4.0), prepend=0.0)
            recording.append(from_samples(one.segment, time, {"gyro_z": counted}, {"gyro_z": "pulse/s"}))
        found = scale_factor(recording)
        assert not coarse(found)
        assert abs(found["K_gyro_z"].value - 200) < 5 * found["K_gyro_z"].standard_uncertainty


def test_missing_samples_at_the_beginning_show_no_count_and_end_no_analysis() -> None:
    recording = []
    for one in on_a_table(14, 0.0):
        blocks = list(one.blocks(("gyro_z",)))
        values = np.concatenate([block.channels["gyro_z"] for block in blocks])
        values = np.where(np.arange(len(values)) < 600, np.nan, values)
        time = np.concatenate([block.time for block in blocks])
        recording.append(from_samples(one.segment, time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    assert not coarse(scale_factor(recording))


def unread(one: RecordedSegment) -> RecordedSegment:
    def refused(channels: Sequence[str]) -> Iterator[Block]:
        raise AssertionError("the screening has read these samples already")

    return replace(one, blocks=refused)


@pytest.mark.parametrize("count", [0.0, 4.0])
def test_the_count_is_found_in_the_pass_of_the_screening(count: float) -> None:
    """The means, the screening and the count need each sample once."""
    read = screened(on_a_table(15, count), sensor("gyro_z"))
    assert len(coarse(scale_factor([unread(one) for one in read]))) == (count > 0)


def test_a_count_that_shows_late_in_a_segment_is_found() -> None:
    """Each output leaves its value in 3 of 3000 samples only, after the first half of the segment."""
    recording = []
    for one in on_a_table(16, 4.0, 0.0):
        values = np.concatenate([block.channels["gyro_z"] for block in one.blocks(("gyro_z",))])
        time = np.concatenate([block.time for block in one.blocks(("gyro_z",))])
        values[[1700, 2100, 2900]] += 4.0
        recording.append(from_samples(one.segment, time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    [text] = coarse(scale_factor(recording))
    assert "too small for counts of 4 pulse/s" in text


def test_values_that_differ_by_floating_point_rounding_are_equal() -> None:
    """A constant output, multiplied by a scale factor in the recording program: the last digit alternates."""
    recording = []
    for one in on_a_table(17, 50.0, 0.0):
        values = np.concatenate([block.channels["gyro_z"] for block in one.blocks(("gyro_z",))]) + 0.1
        time = np.concatenate([block.time for block in one.blocks(("gyro_z",))])
        values[::3] = np.nextafter(values[::3], np.inf)
        recording.append(from_samples(one.segment, time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    [text] = coarse(scale_factor(recording))
    assert "within each segment, all samples are equal" in text


@pytest.mark.parametrize("copied", [True, False])
def test_two_outputs_with_the_same_samples_are_named(copied: bool) -> None:
    """A recording in which the column of one gyro was written twice."""
    recording = []
    for one, other in zip(on_a_table(18, 0.0), on_a_table(19, 0.0), strict=True):
        read = [
            np.concatenate([block.channels["gyro_z"] for block in each.blocks(("gyro_z",))]) for each in (one, other)
        ]
        time = np.concatenate([block.time for block in one.blocks(("gyro_z",))])
        channels = {"gyro_y": read[0] if copied else read[1], "gyro_z": read[0]}
        recording.append(from_samples(one.segment, time, channels, dict.fromkeys(channels, "pulse/s")))
    parameters = ScaleFactorParameters(outputs=("gyro_y", "gyro_z"))
    spec = {"k": EstimateSpec(estimator="scale_factor", segments=("R*",), parameters=parameters)}
    results = analyse(spec, (), recording, SITE, sensor("gyro_y", "gyro_z"))
    said = [text for text in results.estimates["k"].warnings if "gyro_y and gyro_z have the same samples" in text]
    assert len(said) == copied


def rounded_twice(seed: int, first: float, second: float, noise: float) -> list[RecordedSegment]:
    """The table of `on_a_table`; the outputs are rounded to multiples of `first`, then cut off to multiples of `second`."""
    recording = []
    for one in on_a_table(seed, first, noise):
        blocks = list(one.blocks(("gyro_z",)))
        values = np.floor(np.concatenate([block.channels["gyro_z"] for block in blocks]) / second) * second
        time = np.concatenate([block.time for block in blocks])
        recording.append(from_samples(one.segment, time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    return recording


@pytest.mark.parametrize(("first", "declared"), [(1.45, 0.0), (1.45, 1.0), (3.1, 1.0)])
def test_an_output_that_is_rounded_twice_is_named(first: float, declared: float) -> None:
    """The noise is 3.3 counts of 1 pulse/s, so one rounding would average out. Groups at multiples of `first` do not."""
    [text] = coarse(scale_factor(rounded_twice(18, first, 1.0, 3.3), NoiseModel(resolution=declared)))
    assert "multiples of 1 pulse/s, but some multiples are much rarer" in text
    assert "up to 0.5 pulse/s" in text


def test_rounding_twice_is_no_matter_if_the_error_is_far_below_the_noise() -> None:
    assert not coarse(scale_factor(rounded_twice(19, 3.1e-3, 1e-3, 3.3)))


@pytest.mark.parametrize("noise", [0.8, 1.5, 3.3, 20.0])
def test_one_rounding_below_the_noise_is_even(noise: float) -> None:
    for seed in range(20, 26):
        assert not coarse(scale_factor(rounded_twice(seed, 0.0, 1.0, noise)))


def test_a_real_recording_that_is_rounded_again_is_named() -> None:
    """A ring-laser unit at rest, x up: its samples form groups about 0.015 m/s² apart. Cut off to 0.01 m/s², their mean is wrong by
    0.0035 m/s² instead of the 0.005 m/s² of even samples. As recorded, no error of a count is of any size."""
    table = np.fromfile(real("ln100", "x_LN100_up.ins"), "<f8").reshape(-1, 7)
    time, values = table[:, 0] - table[0, 0], table[:, 4]

    def said(shown: np.ndarray) -> list[str]:
        recording = [
            from_samples(
                segment(f"R{k}", np.eye(3), None, 29.0),
                time[(time >= 29 * k) & (time < 29 * k + 28.5)],
                {"accel_x": shown[(time >= 29 * k) & (time < 29 * k + 28.5)]},
                {"accel_x": "m/s^2"},
            )
            for k in range(10)
        ]
        spec = {
            "k": EstimateSpec(
                estimator="repeatability", segments=("R*",), parameters=RepeatabilityParameters(channels=("accel_x",))
            )
        }
        return coarse(analyse(spec, (), recording, SITE, sensor("accel_x", unit="m/s^2")).estimates["k"])

    cut = np.floor(values * 100) / 100
    assert np.mean(cut - values) == pytest.approx(-0.0035, abs=1e-4)
    [text] = said(cut)
    assert "multiples of 0.01 m/s^2, but some multiples are much rarer" in text
    assert not said(values)
