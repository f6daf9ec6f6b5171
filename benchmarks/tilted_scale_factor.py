"""Compares estimating the scale factors of a tilted triad from 10⁸ samples × 3 channels with only reading the recording."""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measuring import counted, peak_memory
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.estimators.analysis import analyse, combined
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.estimators.tilted.parameters import ScaleFactorTiltedParameters
from planrunner.estimators.tilted.scale_factor_tilted import ScaleFactorTilted
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.screening import watch_of
from planrunner.physics.earth import Site
from planrunner.plan.model import EstimateSpec, MountedAxis
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Rest, Schedule, Segment, Spin

AXES = {"x": 0, "y": 120, "z": 240}
CHANNELS = {f"gyro_{axis}": "deg/s" for axis in AXES}
RATES = tuple(sign * rate for rate in (300, 150, 60, 20, 10, 1) for sign in (1, -1))
REPEATS = 6
BLOCK = 100_000
TURNS = 360.0  # s, whole turns at every rate


@dataclass(frozen=True, slots=True)
class Size:
    samples: int
    rounds: int


FULL, SMALL = Size(10**8, 3), Size(10**6, 1)


def planned(samples: int) -> tuple[Segment, ...]:
    steps = [(f"r{repeat}/{label}", rate) for repeat in range(1, REPEATS + 1) for label, rate in _series()]
    hertz = samples / len(steps) / TURNS
    return tuple(
        Segment(index, label, np.eye(3), "home", Spin(math.radians(rate)) if rate else Rest(), TURNS, sample_rate=hertz)
        for index, (label, rate) in enumerate(steps)
    )


def _series() -> list[tuple[str, float]]:
    return [("start-zero", 0.0), *((f"R{rate:+d}", float(rate)) for rate in RATES), ("end-zero", 0.0)]


def blocks(segment: Segment, draw: np.random.Generator) -> Iterator[Block]:
    rate = segment.sample_rate or 1.0
    count, level = round(TURNS * rate), math.degrees(segment.rate) / math.sqrt(3)
    for start in range(0, count, BLOCK):
        length = min(BLOCK, count - start)
        values = level + 0.01 * draw.standard_normal((3, length))
        yield Block((start + np.arange(length)) / rate, dict(zip(CHANNELS, values, strict=True)))


def record(folder: Path, segments: tuple[Segment, ...]) -> Path:
    draw = np.random.default_rng(0)
    with RunWriter.create(folder, "tilted", b"", b"", {}, "flushed") as writer:
        for segment in segments:
            writer.begin(segment, 0.0, CHANNELS)
            for block in blocks(segment, draw):
                writer.append(block, 0.0)
            writer.acknowledge(0.0, {}, {})
        writer.finish()
    return writer.path


def merely_decode(path: Path) -> None:
    """Decodes every sample once with pyarrow alone. Digests are not checked."""
    import pyarrow.parquet as pq

    for part in sorted((path / "segments").iterdir()):
        file = pq.ParquetFile(part)
        for group in range(file.num_row_groups):
            file.read_row_group(group, use_threads=False)


def merely_read(path: Path) -> None:
    """Checks the digest of every file and decodes every sample once, without using the values. It reads the same bytes and columns
    as an estimate."""
    reader = RunReader.open(path)
    for item in reader.acknowledged():
        for _ in reader.blocks(item):
            pass


MOUNTING = {
    axis: MountedAxis(angle=parse_quantity("54.7356 deg"), azimuth=parse_quantity(f"{azimuth} deg"))
    for axis, azimuth in AXES.items()
}
SETUP, SITE = Setup(None, MOUNTING), Site(math.radians(40))


def under_test(schedule: Schedule) -> SensorModel:
    outputs = tuple(OutputModel(name, unit, noise=NoiseModel(1e-4)) for name, unit in CHANNELS.items())
    return SensorModel("gyro-triad", outputs, schedule.segments[0].sample_rate or 1.0)


def estimate_only(path: Path, schedule: Schedule) -> None:
    """Computes the statistics and the coefficients, without screening and without checks."""
    recording = RunReader.open(path).recording(schedule)
    request = EstimateRequest(
        "scale", recording, ScaleFactorTiltedParameters(), SITE, under_test(schedule), setup=SETUP
    )
    assert abs(combined(ScaleFactorTilted().estimate(request))["K_x"].value - 1) < 1e-5


def analysis(path: Path, schedule: Schedule) -> float:
    """Computes the statistics, screens the samples, and makes the estimate with all its checks, like the command `estimate`.
    Returns the time of the estimate after the samples have been read, s."""
    sensor = under_test(schedule)
    recording = RunReader.open(path).recording(schedule, watch_of(sensor))
    read = time.perf_counter()
    spec = EstimateSpec(estimator="scale_factor_tilted", segments=("r*",), parameters=ScaleFactorTiltedParameters())
    results = analyse({"scale": spec}, (), recording, SITE, sensor, SETUP)
    assert abs(results.estimates["scale"]["K_x"].value - 1) < 1e-5
    return time.perf_counter() - read


def openings(path: Path, schedule: Schedule) -> float:
    """Returns how often an analysis opens each file of samples."""
    opened: list[str] = []
    watching = True

    def watch(event: str, details: tuple[object, ...]) -> None:
        if watching and event == "open" and str(details[0]).endswith(".parquet"):
            opened.append(str(details[0]))

    sys.addaudithook(watch)
    analysis(path, schedule)
    watching = False
    return len(opened) / len(list((path / "segments").iterdir()))


def timed(action: Callable[[], object]) -> tuple[float, float]:
    """Returns the elapsed time and the processor time, s."""
    clock, processor = time.perf_counter(), time.process_time()
    action()
    return time.perf_counter() - clock, time.process_time() - processor


def run(size: Size = FULL) -> dict[str, object]:
    samples = size.samples
    segments = planned(samples)
    schedule = Schedule(segments, len(segments) * TURNS)
    with tempfile.TemporaryDirectory() as folder:
        path = record(Path(folder), segments)
        alone: list[float] = []
        times = openings(path, schedule)
        # Alternating, so that none finds the files warmer than the others.
        rounds = [
            (
                timed(lambda: merely_decode(path)),
                timed(lambda: merely_read(path)),
                timed(lambda: estimate_only(path, schedule)),
                timed(lambda: alone.append(analysis(path, schedule))),
            )
            for _ in range(size.rounds)
        ]
    (decoding, _), (reading, reading_cpu), (fit, fit_cpu), (whole, whole_cpu) = np.median(rounds, axis=0)
    return {
        f"pyarrow alone decoding {counted(samples)} samples × 3 channels [s]": decoding,
        "only reading the samples, with a check of the digests [s]": reading,
        "reading the samples, statistics and scale factors [s]": fit,
        f"ratio to only reading, median of {size.rounds} rounds (target ≤ 1.1)": fit / reading,
        "ratio of the processor times": fit_cpu / reading_cpu,
        "the same with screening and all checks, as in the command `estimate` [s]": whole,
        "ratio to only reading": whole / reading,
        "ratio of the processor times, with screening / only reading": whole_cpu / reading_cpu,
        "ratio of the processor times, with screening / without screening (target ≤ 1.2)": whole_cpu / fit_cpu,
        "estimate after the samples have been read, part of the above time [s]": float(np.median(alone)),
        "number of times that each file was opened for the estimate (target 1)": times,
        "peak memory [MB]": peak_memory(),
    }
