"""Delays between the outputs and a recorded motion: measured, corrected, and named. The recordings are drawn here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import DiagnosisOptions
from planrunner.gap.hypotheses.declarations import _of_segment, in_step
from planrunner.tasks.diagnose import corrected_observation, diagnose_recorded, recorded_file
from planrunner.tasks.named_effects import plan_with_estimate
from tests.gap.test_declarations import to_and_fro

RATE = 100.0


def _rolled(observed: Observed, late: Array) -> Observed:
    """The outputs of each segment, late by a number of samples of this segment."""
    values = observed.values.copy()
    for part, shift in zip(observed.segments(), late, strict=True):
        values[part] = np.roll(values[part], int(shift), axis=0)
    return replace(observed, values=values)


def _in_step(observed: Observed) -> tuple[Observed, list[tuple[str, dict[str, float], str]]]:
    def read(late: Mapping[str, float]) -> Observed:
        return _rolled(observed, np.array([-round(late[label] * RATE) for label in observed.labels]))

    seen, found = in_step(observed, read, 1 / RATE)
    return seen, [(one.effect, dict(one.parameters), one.message) for one in found]


@pytest.mark.parametrize("late", [0, 1, -1])
def test_a_delay_of_a_sample_is_left_as_it_is(late: int) -> None:
    made = _rolled(to_and_fro(sampling=RATE), np.full(6, late))
    seen, found = _in_step(made)
    assert seen is made and not found


@pytest.mark.parametrize(("late", "effect"), [(40, "time_latency"), (-7, "reference_latency")])
def test_a_delay_is_named_with_its_size_and_corrected(late: int, effect: str) -> None:
    sound = to_and_fro(sampling=RATE)
    seen, ((name, parameters, message),) = _in_step(_rolled(sound, np.full(6, late)))
    assert name == effect and ("late" if late > 0 else "early") in message
    assert parameters["delay"] == pytest.approx(abs(late) / RATE, abs=2 * 0.0029)
    assert np.allclose(seen.values, sound.values)


@pytest.mark.parametrize("lost", [25, 50])
def test_lost_samples_are_named_with_the_segment_after_which_they_were_lost(lost: int) -> None:
    sound = to_and_fro(sampling=RATE)
    seen, ((name, parameters, message),) = _in_step(_rolled(sound, np.array([0, 0, 0, -lost, -lost, -lost])))
    assert name == "samples_dropped" and "'part_3'" in message
    assert parameters["lost"] == pytest.approx(1e3 * lost / RATE, abs=2 * 4.1)
    assert parameters["time"] == pytest.approx(sound.time[sound.bounds[3] - 1])
    assert np.allclose(seen.values, sound.values)


@pytest.mark.parametrize("late", [[40], [0, 30], [0, 30, 30], [0, 6, 12, 18, 24, 30, 36, 42]])
def test_each_segment_of_a_few_or_with_a_slow_clock_gets_its_own_delay(late: list[int]) -> None:
    """One segment, lost samples in one of a few, and clocks at different rates."""
    sound = to_and_fro(segments=len(late), sampling=RATE)
    seen, found = _in_step(_rolled(sound, np.array(late)))
    assert len(found) == 1
    assert np.allclose(seen.values, sound.values)


def test_what_whole_samples_leave_of_a_delay_counts_once() -> None:
    sound = to_and_fro(sampling=RATE)
    draw = np.random.default_rng(3)

    def read(late: Mapping[str, float]) -> Observed:
        values = np.radians(0.1) * draw.normal(size=sound.values.shape)
        for part, label in zip(sound.segments(), sound.labels, strict=True):
            left = 0.1049 - round(late.get(label, 0.0) * RATE) / RATE
            since = sound.time[part] - sound.time[part][0]
            values[part, 2] += np.radians(40) * np.cos(2 * np.pi * 0.4 * (since - left))
        return replace(sound, values=values)

    _, (found,) = in_step(read({}), read, 1 / RATE)
    assert found.parameters["delay"] == pytest.approx(0.1049, abs=5e-4)


def test_noise_without_motion_has_no_delay() -> None:
    sound = to_and_fro(sampling=RATE)
    noise = replace(sound, values=np.random.default_rng(1).normal(size=sound.values.shape))
    assert _in_step(noise) == (noise, [])


PLAN = """
planrunner: 1
title: Gyro on an arm with an encoder
bench: ./arm.bench.yaml
sensor: {kind: imu, outputs: [gyro_z]}
defaults:
  orientation: {x: east, y: north, z: up}
  dwell: recorded
  motion: {about: up, recorded: {angle: encoder, averaging: 100 ms}}
segments:
  - {label: "part_{repeat}", repeat: 4}
report: [summary.md]
"""
BENCH = """
planrunner_bench: 1
name: arm
clock: virtual
site: {latitude: 45 deg, gravity: 9.80665 m/s^2}
instruments:
  imu:
    driver: recording
    kind: imu
    file: arm.parquet
    sample_rate: 100 Hz
    time: {column: t, unit: s}
    stretches:
      part_1: {start: 1 s, end: 21 s}
      part_2: {start: 21 s, end: 41 s}
      part_3: {start: 41 s, end: 61 s}
      part_4: {start: 61 s, end: 81 s}
    channels:
      gyro_z: {column: gz, unit: deg/s, noise: 0.1 deg/s}
      encoder: {column: angle, unit: deg}
"""


def test_a_recording_in_a_file_is_read_again_without_its_delay(tmp_path: Path) -> None:
    time = np.arange(8300) / RATE
    draw = np.random.default_rng(4)

    def angle(at: Array) -> Array:
        return 40 * np.sin(2.1 * at) + 15 * np.sin(0.83 * at)

    rate = 40 * 2.1 * np.cos(2.1 * (time - 0.21)) + 15 * 0.83 * np.cos(0.83 * (time - 0.21))
    table = {"t": time, "gz": 1.01 * rate + 0.3 + draw.normal(0, 0.1, len(time)), "angle": angle(time)}
    pq.write_table(pa.table(table), tmp_path / "arm.parquet")
    (tmp_path / "arm.yaml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "arm.bench.yaml").write_text(BENCH, encoding="utf-8")
    recorded = recorded_file(tmp_path / "arm.yaml", None, tmp_path / "arm.parquet")
    seen, (found,), findings = corrected_observation(recorded, ("gyro_bias",))
    assert found.effect == "time_latency"
    assert found.parameters["delay"] == pytest.approx(0.21, abs=2 * 0.0029)
    assert any(one.code == "gap-declaration" and "210" in one.message for one in findings)
    left = seen.values[:, 0] - 1.01 * seen.omega[:, 2] - np.radians(0.3)
    assert np.degrees(left.std()) < 0.2  # deg/s; with the delay, it would be more than 10


def test_the_plan_of_an_effect_in_a_recorded_motion_contains_its_segments(tmp_path: Path) -> None:
    """`--write-plan` adds an estimate over the segments with a recorded motion, which the check of the plan accepts."""
    time = np.arange(8300) / RATE
    rate = 40 * 2.1 * np.cos(2.1 * time) + 15 * 0.83 * np.cos(0.83 * time)
    noise = np.random.default_rng(4).normal(0, 0.1, len(time))
    angle = 40 * np.sin(2.1 * time) + 15 * np.sin(0.83 * time)
    pq.write_table(pa.table({"t": time, "gz": 1.02 * rate + noise, "angle": angle}), tmp_path / "arm.parquet")
    (tmp_path / "arm.yaml").write_text(PLAN + "diagnosis: {nominal: [gyro_bias]}\n", encoding="utf-8")
    (tmp_path / "arm.bench.yaml").write_text(BENCH, encoding="utf-8")
    recorded = recorded_file(tmp_path / "arm.yaml", None, tmp_path / "arm.parquet")
    made = diagnose_recorded(recorded, DiagnosisOptions(("gyro_bias",), ("gyro_scale_factor",)))
    assert made.diagnosis.verdict.effects == ("gyro_scale_factor",)
    assert "diagnosed" in plan_with_estimate(made).sound().plan.estimates


@pytest.mark.parametrize("delay", [-0.4137, 0.0, 0.0123, 0.137, 1.3])
@pytest.mark.parametrize("regular", [True, False])
def test_the_search_of_a_delay_evaluates_all_samples_only_near_it(
    delay: float, regular: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motion about three axes at 100 Hz, with regular and irregular times. The standard uncertainty is that of 9000 readings."""
    draw = np.random.default_rng(5)
    time = (np.arange(3000) + (0.0 if regular else 1.0) * draw.uniform(-0.4, 0.4, 3000)) / RATE
    hertz, phase, size = draw.uniform(0.1, 1.2, (6, 3)), draw.uniform(0, 6.3, (6, 3)), draw.uniform(5, 30, (6, 3))

    def rates(at: Array) -> Array:
        return np.radians((size * np.sin(2 * np.pi * hertz * at[:, None, None] + phase)).sum(axis=1))

    mixed = np.eye(3) + 0.01 * draw.normal(size=(3, 3))
    outputs = rates(time - delay) @ mixed + 0.01 + np.radians(0.1) * draw.normal(size=(3000, 3))
    sound = to_and_fro(segments=1, sampling=3000 / 20.0)
    seen = replace(sound, time=time, values=np.hstack([outputs, sound.values[:, 3:]]))
    seen.__dict__["omega"] = rates(time)
    fits = []

    def counted(columns: Array, values: Array, rcond: None) -> object:
        fits.append(1)
        return lstsq(columns, values, rcond=rcond)

    lstsq = np.linalg.lstsq
    monkeypatch.setattr(np.linalg, "lstsq", counted)
    found = _of_segment(seen, slice(0, 3000))
    assert found is not None
    assert found.uncertainty < 2e-5
    assert abs(found.seconds - delay) < 4 * found.uncertainty
    assert len(fits) < 60  # of 801 delays
