"""Recorded segments for tests: from chosen means, from arrays, and from the real recordings."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from planrunner.archive.recording import RecordedSegment, Statistics
from planrunner.archive.statistics import statistics_of
from planrunner.estimators.tables import Cell
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.plan.schedule import Motion, Rest, Segment

DATA = Path(os.environ.get("PLANRUNNER_DATA", Path(__file__).resolve().parents[2].parent / "shared" / "data"))


def real(*parts: str) -> Path:
    """A file of the real recordings; the test is skipped where it is absent."""
    path = DATA.joinpath(*parts)
    if not path.is_file():
        pytest.skip(f"the real recording {'/'.join(parts)} is not beneath {DATA} (set PLANRUNNER_DATA)")
    return path


def figure(cell: Cell) -> float:
    """A table's cell that holds a number, or a number as text."""
    assert cell is not None
    return float(cell)


def segment(
    label: str, attitude: np.ndarray | None = None, motion: Motion | None = None, dwell: float = 120.0
) -> Segment:
    return Segment(0, label, attitude, "as tested", motion or Rest(), dwell)


def sensor(*outputs: str, unit: str = "pulse/s", noise: NoiseModel | None = None) -> SensorModel:
    return SensorModel(
        "under-test", tuple(OutputModel(name, unit, noise=noise or NoiseModel()) for name in outputs), 10.0
    )


def from_means(
    planned: Segment,
    means: Mapping[str, float],
    unit: str,
    standard_error: Sequence[float] | np.ndarray | float = 0.0,
    batches: int = 32,
    count: int = 1200,
    start: float = 0.0,
) -> RecordedSegment:
    """A segment whose statistics are given; its samples cannot be read. start: s."""
    mean = np.array(list(means.values()))
    error = np.broadcast_to(np.asarray(standard_error, dtype=float), mean.shape).copy()
    covariance = np.diag(error**2 * count)
    seconds = planned.dwell or 1.0
    period = seconds / max(count, 1)
    last = start + seconds - period
    statistics = Statistics(tuple(means), count, 0, mean, mean, mean, covariance, error, batches, start, last, period)

    def no_samples(channels: Sequence[str]) -> Iterator[Block]:
        raise AssertionError("this estimator must do with statistics")

    return RecordedSegment(planned, dict.fromkeys(means, unit), statistics, no_samples, finds=())


def from_samples(
    planned: Segment, time: np.ndarray, channels: Mapping[str, np.ndarray], units: Mapping[str, str], rows: int = 997
) -> RecordedSegment:
    """A segment from arrays, read back in blocks of `rows`."""

    def blocks(names: Sequence[str]) -> Iterator[Block]:
        for low in range(0, len(time), rows):
            high = low + rows
            yield Block(time[low:high], {name: channels[name][low:high] for name in names})

    statistics = statistics_of(blocks(tuple(channels)), tuple(channels), len(time), motion=planned.motion)
    return RecordedSegment(planned, dict(units), statistics, blocks)


def played(
    planned: Segment, means: Mapping[str, float], noise: np.ndarray, unit: str, start: float = 0.0
) -> RecordedSegment:
    """A segment whose samples are means plus noise (channels, samples); planrunner computes the statistics. start: s."""
    time = start + np.arange(noise.shape[1]) * (planned.dwell or 1.0) / noise.shape[1]
    channels = {name: mean + row for (name, mean), row in zip(means.items(), noise, strict=True)}
    return from_samples(planned, time, channels, dict.fromkeys(means, unit))


def noisy(
    planned: Segment,
    values: Mapping[str, np.ndarray | float],
    unit: str,
    error: float | np.ndarray,
    draw: np.random.Generator,
    start: float = 0.0,
    samples: int = 320,
) -> RecordedSegment:
    """A segment of samples, `values` plus white noise; planrunner computes the statistics.

    values: the output without noise, a number or (samples,); error: standard uncertainty of the mean of each channel; start: s.
    """
    exact = np.array([np.broadcast_to(one, samples) for one in values.values()], dtype=float)
    size = np.broadcast_to(np.asarray(error, dtype=float), len(exact))[:, None] * math.sqrt(samples)
    made = exact + size * draw.standard_normal(exact.shape)
    return played(planned, dict.fromkeys(values, 0.0), made, unit, start)


def table(path: Path) -> dict[str, np.ndarray]:
    """A Parquet file as arrays."""
    import pyarrow.parquet as parquet

    read = parquet.read_table(path)
    return {name: read[name].to_numpy().astype(float) for name in read.column_names}


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
