"""Channels that stand at one value through a whole segment: stuck ones are named, those that may stand are not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.archive.recording import Find, FindKind, RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.screening import screened
from planrunner.plan.schedule import Rest, Segment, Spin

Array = NDArray[np.float64]
ROWS, RATE = 3000, 100.0


def recorded(index: int, values: Array, unit: str, rate: float = 0.0) -> RecordedSegment:
    time = 1000.0 * index + np.arange(len(values)) / RATE

    def blocks(names: Sequence[str]) -> Iterator[Block]:
        yield Block(time, dict.fromkeys(names, values))

    planned = Segment(index, f"P{index}", np.eye(3), "as tested", Spin(rate) if rate else Rest(), len(values) / RATE)
    return RecordedSegment(planned, {"x": unit}, statistics_of(blocks(["x"]), ["x"], len(values)), blocks)


def finds(*segments: Array, unit: str = "deg/s", noise: NoiseModel | None = None) -> list[Find]:
    sensor = SensorModel("unit", (OutputModel("x", unit, noise=noise or NoiseModel()),), RATE)
    found = screened([recorded(index, values, unit) for index, values in enumerate(segments)], sensor)
    return [one for item in found for one in item.finds or ()]


def white(seed: int, sigma: float = 1.0, count: float = 0.0, level: float = 0.0) -> Array:
    values = level + np.random.default_rng(seed).normal(0.0, sigma, ROWS)
    return values if not count else np.round(values / count) * count


def standing(value: float = 0.25, rows: int = ROWS) -> Array:
    return np.full(rows, value)


@pytest.mark.parametrize("count", [0.0, 0.5, 1.0])
def test_a_segment_at_one_value_is_named_if_the_channel_is_noisy_in_others(count: float) -> None:
    (one,) = finds(white(1, count=count), standing(), white(2, count=count))
    assert (one.kind, one.channel, one.first, one.rows, one.size) == (FindKind.STUCK, "x", 0, ROWS, 0.25)
    assert not one.bad and one.seconds == pytest.approx(30.0)  # named; a person decides


@pytest.mark.parametrize("unit", ["deg", "degC"])
def test_encoders_and_thermometers_may_stand(unit: str) -> None:
    assert finds(white(1), standing(), white(2), unit=unit) == []


@pytest.mark.parametrize(
    "others",
    [
        (white(1, 0.1, 1.0, 0.5), white(2, 0.1, 1.0, 0.5)),  # coarse counts: two of them alternate elsewhere
        (white(1, 0.25, 1.0), white(2, 0.25, 1.0)),  # coarse counts: rarely another one
        (np.sin(np.arange(ROWS) / 300), np.cos(np.arange(ROWS) / 500)),  # a signal without noise that drifts
        (standing(1.0), standing(2.0), white(3)),  # a set point that stands in most segments
        (standing(1.0),),
        (),
    ],
    ids=["alternating counts", "rare counts", "without noise", "set point", "never moves", "alone"],
)
def test_what_may_stand_is_left_alone(others: tuple[Array, ...]) -> None:
    assert not [one for one in finds(standing(), *others) if one.rows == ROWS]


def test_too_few_samples_show_nothing() -> None:
    assert finds(white(1), standing(rows=50), white(2)) == []


@pytest.mark.parametrize(
    ("noise", "found"),
    [
        (NoiseModel(white=0.1), 1),  # 1 deg/s between samples
        (NoiseModel(white=0.1, resolution=0.5), 1),
        (NoiseModel(white=0.01, resolution=1.0), 0),  # 0.1 deg/s, far below a count
        (NoiseModel(), 0),
    ],
)
def test_a_single_segment_is_judged_by_the_declared_noise(noise: NoiseModel, found: int) -> None:
    assert len(finds(standing(), noise=noise)) == found
