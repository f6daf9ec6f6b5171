"""Long recordings: what bins hold against the samples they are made of, and the same diagnosis from either."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import Diagnosis, diagnose
from planrunner.gap.evidence.covariance import lasting
from planrunner.gap.hypotheses.candidates import FULL, Weighing, nominal_columns
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation import bins
from planrunner.observation.samples import observed, poses
from planrunner.plan.schedule import Motion, Rest, Rock, Segment, Spin
from tests.gap.turntable import ACCEL_WHITE, DEG, GYRO_WHITE, SITE, Fault, G, record

Array = np.ndarray
GYRO, ACCEL = [f"gyro_{axis}" for axis in "xyz"], [f"accel_{axis}" for axis in "xyz"]
UNITS = dict.fromkeys(GYRO, "deg/s") | dict.fromkeys(ACCEL, "m/s^2") | {"table_angle": "deg", "warmth": "degC"}
GYRO_NOISE, ACCEL_NOISE = NoiseModel(GYRO_WHITE / DEG, 0.0, 5e-4), NoiseModel(ACCEL_WHITE, 0.0, 2e-4)
SENSOR = SensorModel(
    "imu",
    (
        *(OutputModel(name, "deg/s", noise=GYRO_NOISE) for name in GYRO),
        *(OutputModel(name, "m/s^2", noise=ACCEL_NOISE) for name in ACCEL),
    ),
    100.0,
)


def _segment(
    index: int, motion: Motion, time: Array, columns: dict[str, Array], attitude: Array | None = None, block: int = 777
) -> RecordedSegment:
    def blocks(names: Sequence[str]) -> Iterator[Block]:
        for first in range(0, len(time), block):
            part = slice(first, first + block)
            yield Block(time[part], {name: columns[name][part] for name in names})

    names = tuple(columns)
    made = Segment(index, f"S{index}", attitude, "given", motion, float(time[-1] - time[0]), temperature=298.15)
    units = {name: UNITS[name] for name in names}
    return RecordedSegment(made, units, statistics_of(blocks(names), names, len(time)), blocks)


def _recorded(seen: Observed) -> list[RecordedSegment]:
    """A simulated recording in blocks, with an encoder that wraps and a thermometer."""
    found = []
    for index, part in enumerate(seen.segments()):
        columns = {name: seen.values[part, c] / seen.channels[c].factor for c, name in enumerate(GYRO + ACCEL)}
        columns["table_angle"] = np.degrees(seen.angle[part]) % 360.0
        columns["warmth"] = seen.temperature[part]
        found.append(_segment(index, seen.motions[index], seen.time[part], columns, seen.attitude[index]))
    return found


def _observed(recording: list[RecordedSegment]) -> Observed:
    return observed(
        recording, SITE, SENSOR, angle_channel="table_angle", temperature_channel="warmth", magnetic=(0.0, 0.55, -0.83)
    )


def _unbalanced(size: float) -> Fault:
    def unbalance(seen: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array]:
        return force / G @ np.array([[0, 3, 0], [-2, 0, 1], [0, 1, 0]]) * size * DEG, np.zeros(3)

    return unbalance


@pytest.fixture(scope="module")
def recording() -> list[RecordedSegment]:
    return _recorded(record(seed=4, sampling=100.0))


def test_the_nominal_stimulus_is_the_mean_over_a_bin(
    recording: list[RecordedSegment], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = _observed(recording)
    assert whole.bins is None
    monkeypatch.setattr(bins, "BUDGET", len(whole.time) // 8)
    coarse = _observed(recording)
    assert coarse.bins is not None
    moving = [not isinstance(motion, Rest) for motion in coarse.motions]
    assert coarse.bins.size[moving].min() == 3  # a period of 2 s in 64
    assert coarse.bins.size.max() > 8
    assert len(coarse.time) < len(whole.time) / 5
    assert coarse.sample_rate == pytest.approx(whole.sample_rate)
    binned, samples = lasting(coarse), lasting(whole)
    assert binned[0] == pytest.approx(samples[0], rel=1e-12)
    assert (np.abs(binned[1] - samples[1]) < coarse.bins.size / 100).all()  # less than a bin is left out
    for index, (fine, few) in enumerate(zip(whole.segments(), coarse.segments(), strict=True)):
        size, n = int(coarse.bins.size[index]), few.stop - few.start
        for name, scale in (("omega", 1e-7), ("force", 1e-6), ("values", 1e-12), ("time", 1e-9)):
            means = getattr(whole, name)[fine][: n * size].reshape(n, size, -1).mean(1)
            assert getattr(coarse, name)[few].reshape(n, -1) == pytest.approx(means, abs=scale, rel=0), (name, index)


def _answer(found: Diagnosis) -> tuple[tuple[str, ...], dict[str, tuple[float, float]]]:
    return found.verdict.effects, {p.name: (p.value, p.standard_uncertainty) for p in found.parameters}


@pytest.mark.slow
@pytest.mark.parametrize("size", [6e-5, 6e-4])
def test_a_binned_recording_has_the_same_diagnosis(size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that is hardly told from none, and a clear one."""
    recording = _recorded(record(seed=4, fault=_unbalanced(size), sampling=100.0))
    whole = diagnose(_observed(recording))
    monkeypatch.setattr(bins, "BUDGET", 20_000)
    coarse = diagnose(_observed(recording))
    assert _answer(coarse)[0] == _answer(whole)[0]
    if size == 6e-4:
        assert _answer(whole)[0] == ("gyro_g_sensitivity",)
        assert whole.closure.resolvable
    before, after = whole.posterior.probability, coarse.posterior.probability
    for name in {*before, *after}:  # pairs that are out of the question are in neither
        assert after.get(name, 0.0) == pytest.approx(before.get(name, 0.0), abs=0.01), name
    for name, (value, sigma) in _answer(whole)[1].items():
        other, its = _answer(coarse)[1][name]
        assert other == pytest.approx(value, abs=0.02 * sigma)
        assert its == pytest.approx(sigma, rel=1e-3)
    assert coarse.closure.shrinks_by == pytest.approx(whole.closure.shrinks_by, abs=0.03, nan_ok=True)
    for name, gap in whole.gap.items():
        assert coarse.gap[name]["noise_floor"] == pytest.approx(gap["noise_floor"], rel=1e-3)
        assert coarse.gap[name]["before"] == pytest.approx(gap["before"], rel=0.01)


def test_nominal_columns_leave_nothing_of_a_noiseless_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A perfect sensor with a scale factor, turning and rocking: whatever averaging does to it, the nominal model does too."""
    seen = record(seed=5, noise=0.0, sampling=100.0)
    exact = np.hstack([seen.omega * 1.01, seen.force * 0.99])
    made = _recorded(Observed(**{n: getattr(seen, n) for n in seen.__dataclass_fields__} | {"values": exact}))
    monkeypatch.setattr(bins, "BUDGET", 20_000)
    found = _observed(made)
    columns = nominal_columns(found, FULL)
    for index in range(6):
        design = np.column_stack([column.parts[index] for column in columns if index in column.parts])
        left = found.values[:, index] - design @ np.linalg.lstsq(design, found.values[:, index], rcond=None)[0]
        assert np.abs(left).max() < 1e-6 * np.abs(found.values[:, index]).max()


def test_white_level_counts_and_spikes_are_those_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    draw = np.random.default_rng(7)
    time = np.arange(60_000) / 100

    def segment(index: int) -> RecordedSegment:
        rate = np.round((0.1 + draw.normal(0, 0.014, len(time))) / 2e-3) * 2e-3  # four declared counts
        rate[[77, 5_000, 5_001, 59_990]] = [40.0, -3.0, -3.0, 1.0]
        rate[123] = np.nan
        return _segment(index, Rest(), time + 1e3 * index, {"gyro_x": rate}, np.eye(3))

    monkeypatch.setattr(bins, "BUDGET", 3_000)
    seen = observed([segment(i) for i in range(4)], SITE, SENSOR)
    assert seen.rejected == 4
    assert seen.bins is not None
    assert list(seen.bins.spikes) == [16]
    weighing = Weighing(seen, ("gyro_bias",))
    assert weighing.steps == pytest.approx([2e-3 * DEG])
    sigma = np.hypot(0.014, 2e-3 / np.sqrt(12)) * DEG
    assert weighing.white == pytest.approx([sigma], rel=3 / np.sqrt(2 * 180_000) + 1e-3)
    scatter = weighing.spectrum.remainder.std()
    assert scatter == pytest.approx(sigma, rel=4 / np.sqrt(2 * 3_000))


def test_poses_in_unknown_orientations_are_binned(monkeypatch: pytest.MonkeyPatch) -> None:
    draw = np.random.default_rng(8)
    up = draw.normal(size=(14, 3))
    up *= G / np.linalg.norm(up, axis=1)[:, None]
    time = np.arange(4_000) / 100
    made = []
    for index, force in enumerate(up):
        read = force + draw.normal(0, [3e-3, 3e-3, 3e-3], (len(time), 3))
        made.append(_segment(index, Rest(), time + 100 * index, dict(zip(ACCEL, read.T, strict=True))))
    whole = poses(made, SITE, SENSOR, ("accel_bias",))
    monkeypatch.setattr(bins, "BUDGET", 2_000)
    coarse = poses(made, SITE, SENSOR, ("accel_bias",))
    assert len(coarse.time) <= 2_000
    levels = [Weighing(seen, ("accel_bias",)).white[0] for seen in (whole, coarse)]
    assert levels[0] == pytest.approx(3e-3, rel=0.02)
    assert levels[1] == pytest.approx(levels[0], rel=0.01)


def test_samples_come_in_pieces_of_one_size_however_they_were_cut() -> None:
    time = np.arange(25.0)
    blocks = [
        Block(time[low:high], {"x": time[low:high], "y": -time[low:high]})
        for low, high in ((0, 3), (3, 4), (4, 19), (19, 25))
    ]
    pieces = list(bins.rechunk(blocks, ["y", "x"], 10))
    assert [len(piece[0]) for piece in pieces] == [10, 10, 5]
    np.testing.assert_array_equal(np.concatenate([piece[1] for piece in pieces], axis=1), np.stack([-time, time]))


def test_bins_keep_to_the_budget_unless_motion_is_too_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(40_000) / 100

    def sized(*motions: Motion) -> list[int]:
        quiet = {"gyro_x": np.zeros(len(time))}
        made = bins.sizes([_segment(i, motion, time, quiet, np.eye(3)) for i, motion in enumerate(motions)])
        return [] if made is None else [int(size) for size in made]

    monkeypatch.setattr(bins, "BUDGET", 10_000)
    still = sized(Rest(), Rest(), Rest())
    assert sum(40_000 // size for size in still) <= 10_000
    assert max(still) < 15
    mixed = sized(Rest(), Spin(45 * DEG), Rock(DEG, 1.0, (0.0,), 400.0))
    assert mixed == [625, 12, 1]  # 64 bins in a segment, a turn of 8 s, a period of 1 s
    monkeypatch.setattr(bins, "BUDGET", 120_000)
    assert sized(Rest(), Rest(), Rest()) == []


_MEMORY = """
import resource, sys
import numpy as np
from planrunner.observation.samples import observed
from planrunner.plan.schedule import Rest
from tests.observation.test_bins import SENSOR, SITE, held_by_no_one
held = observed([held_by_no_one(i, int(sys.argv[1]) // 4) for i in range(4)], SITE, SENSOR)
assert len(held.time) <= 200_000, len(held.time)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def held_by_no_one(index: int, rows: int) -> RecordedSegment:
    """A segment at rest whose blocks are drawn as they are read."""

    def blocks(names: Sequence[str]) -> Iterator[Block]:
        draw = np.random.default_rng(index)
        for first in range(0, rows, 65_536):
            n = min(65_536, rows - first)
            yield Block(1e6 * index + (first + np.arange(n)) / 100, {name: draw.normal(0, 0.01, n) for name in names})

    made = Segment(index, f"S{index}", np.eye(3), "given", Rest(), rows / 100, temperature=298.15)
    return RecordedSegment(made, {"gyro_x": "deg/s"}, statistics_of(blocks(("gyro_x",)), ("gyro_x",), rows), blocks)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_samples() -> None:
    peaks = []
    for rows in (1_000_000, 10_000_000):
        done = subprocess.run([sys.executable, "-c", _MEMORY, str(rows)], check=True, capture_output=True, text=True)
        peaks.append(float(done.stdout))
    assert peaks[1] < peaks[0] + 20  # MB; a column of the samples added is 72
