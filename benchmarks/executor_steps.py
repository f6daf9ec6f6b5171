"""Measures the steps per second (set, read, record) of the executor with a trivial instrument, and of a bare loop, OpenHTF and bluesky.

The bare loop makes the same writes with fsync.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planrunner.archive.run_folder import RunWriter
from planrunner.bench.clock import VirtualClock
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import Block, OwnLimits
from planrunner.plan.schedule import Rest, Schedule, Segment

ATTITUDES = (np.eye(3), np.diag([1.0, -1.0, -1.0]))
ROWS = 100
CHANNELS = {"x": "V", "y": "V", "z": "V"}


@dataclass(frozen=True, slots=True)
class Size:
    """Numbers of steps: of the flushed runs, of the two runs whose memory is compared, of the durable runs, and of the other
    programs. Also the number of pairs of durable runs."""

    flushed: tuple[int, ...]
    memory: tuple[int, int]
    durable: int
    pairs: int
    peers: int


FULL = Size((100, 1000, 10_000, 100_000), (1000, 10_000), 100, 5, 1000)
SMALL = Size((20, 100), (20, 100), 5, 1, 20)


class Axis:
    """The simplest axis that can be set and read."""

    def __init__(self) -> None:
        self.position = 0.0

    def identify(self) -> Mapping[str, str]:
        return {"model": "axis"}

    def orient(self, attitude: Any) -> float:
        self.position = float(attitude[2, 2])
        return 0.0

    def holding(self) -> bool:
        return True

    def read(self) -> Mapping[str, float]:
        return {"position_rad": self.position}

    def make_safe(self) -> None: ...

    def close(self) -> None: ...


class Probe:
    """A sensor that returns the same short block for every segment."""

    def __init__(self) -> None:
        self.time = np.arange(ROWS, dtype=float) * 0.01
        self.values = np.random.default_rng(0).standard_normal((3, ROWS))

    def identify(self) -> Mapping[str, str]:
        return {"model": "probe"}

    def channels(self) -> Mapping[str, str]:
        return CHANNELS

    def stream(self, segment: Segment) -> Iterator[Block]:
        yield Block(self.time, dict(zip(CHANNELS, self.values, strict=True)))

    def make_safe(self) -> None: ...

    def close(self) -> None: ...


class Bench:
    def __init__(self, sensor: Any = None):
        self.clock = VirtualClock()
        self.table, self.chamber, self.sensor = Axis(), None, sensor
        self.monitors: list[Any] = []
        self.instruments = {"axis": self.table, **({"probe": sensor} if sensor else {})}
        self.limits = OwnLimits()

    def sign_of_life(self) -> None:
        """Does nothing, because there is no watchdog."""

    def take_control(self, *names: str) -> None:
        """Does nothing, because the whole bench is always made safe."""

    @property
    def untouched(self) -> tuple[str, ...]:
        return ()

    def make_safe(self) -> list[str]:
        return []


def schedule(steps: int) -> Schedule:
    return Schedule(tuple(Segment(i, f"s{i}", ATTITUDES[i % 2], "", Rest(), 0.0) for i in range(steps)), 0.0)


def planrunner_steps(folder: Path, steps: int, durability: Any, sensor: Any = None) -> float:
    """Returns the number of steps per second. The time includes the seal, but not the creation of the folder."""
    plan = schedule(steps)
    with RunWriter.create(folder, "steps", b"", b"", {}, durability) as writer:
        began = time.perf_counter()
        outcome = execute(plan, Bench(sensor), writer, stop=StopRequest())
        seconds = time.perf_counter() - began
    assert outcome.ok
    return steps / seconds


def bare_durable_steps(folder: Path, steps: int) -> float:
    """Performs only the same writes, renames and fsyncs: for each step, one Parquet file and one line of a journal."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder.mkdir()
    probe = Probe()
    with (folder / "journal.jsonl").open("wb", buffering=0) as journal:
        began = time.perf_counter()
        for step in range(steps):
            table = pa.table({"time": probe.time, **dict(zip(CHANNELS, probe.values, strict=True))})
            aside, path = folder / f"{step}.partial", folder / f"{step}.parquet"
            with aside.open("wb", buffering=0) as file:
                pq.write_table(table, file, compression="snappy", use_dictionary=False)
                os.fsync(file.fileno())
            os.replace(aside, path)
            descriptor = os.open(folder, os.O_RDONLY)
            os.fsync(descriptor)
            os.close(descriptor)
            journal.write(json.dumps({"step": step, "file": path.name, "rows": ROWS}).encode() + b"\n")
            os.fsync(journal.fileno())
        return steps / (time.perf_counter() - began)


def peak_growth(folder: Path, few: int, many: int) -> float:
    """Returns the increase of the peak memory per additional step, in bytes, as Python's allocator counts it."""
    peaks = []
    for steps in (few, many):
        plan = schedule(steps)
        with RunWriter.create(folder, "memory", b"", b"", {}, "flushed") as writer:
            tracemalloc.start()
            execute(plan, Bench(), writer, stop=StopRequest())
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    return (peaks[1] - peaks[0]) / (many - few)


def openhtf_steps(folder: Path, steps: int) -> float:
    """Runs OpenHTF with one phase and one measurement for each step. The record is written as JSON at the end."""
    import openhtf as htf
    from openhtf.output.callbacks import json_factory

    axis = Axis()

    def phase(number: int) -> Any:
        @htf.PhaseOptions(name=f"s{number}")
        @htf.measures(htf.Measurement("position"))
        def step(test: Any) -> None:
            axis.orient(ATTITUDES[number % 2])
            test.measurements.position = axis.read()["position_rad"]

        return step

    test = htf.Test(*[phase(number) for number in range(steps)], test_name="steps")
    test.add_output_callbacks(json_factory.OutputToJSON(str(folder / "openhtf.json")))
    began = time.perf_counter()
    assert test.execute(test_start=lambda: "dut")
    return steps / (time.perf_counter() - began)


def bluesky_steps(folder: Path, steps: int) -> float:
    """Runs bluesky: at every step, a soft positioner is set and read. The documents are written as JSON lines."""
    from bluesky import RunEngine
    from bluesky import plan_stubs as stubs
    from bluesky.preprocessors import run_decorator
    from ophyd.sim import SynAxis

    axis = SynAxis(name="axis")
    engine = RunEngine({}, context_managers=[])
    with (folder / "bluesky.jsonl").open("w", buffering=1) as file:

        def write(name: str, document: Any) -> None:
            file.write(json.dumps([name, document], default=str) + "\n")

        engine.subscribe(write)

        @run_decorator()
        def plan() -> Any:
            for number in range(steps):
                yield from stubs.mv(axis, float(number % 2))
                yield from stubs.trigger_and_read([axis])

        began = time.perf_counter()
        engine(plan())
        return steps / (time.perf_counter() - began)


def peer(name: str, measure: Callable[[Path, int], float], folder: Path, steps: int) -> dict[str, object]:
    """Returns the steps per second of another program, and the ratio of planrunner's speed to it. If the program is not installed,
    returns a message instead."""
    try:
        theirs = max(measure(folder, steps) for _ in range(2))
    except ImportError as missing:
        return {f"{name} [steps/s]": f"skipped: {missing.name} is not installed (pip install -e .[bench])"}
    ours = max(planrunner_steps(folder, steps, "flushed") for _ in range(2))
    return {f"{name}, {steps} steps [steps/s]": theirs, f"planrunner / {name}": ours / theirs}


def run(size: Size = FULL) -> dict[str, object]:
    figures: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        planrunner_steps(folder, 100, "flushed")  # imports
        for steps in size.flushed:
            rates = [planrunner_steps(folder, steps, "flushed") for _ in range(3 if steps < 100_000 else 1)]
            figures[f"flushed, {steps} steps [steps/s] (target ≥ 10 000)"] = max(rates)
        figures[f"peak memory per step, {size.memory[0]} to {size.memory[1]} steps [bytes]"] = peak_growth(
            folder, *size.memory
        )
        planrunner_steps(folder, 10, "durable", Probe())
        pairs = []
        for round_ in range(size.pairs):
            bare = bare_durable_steps(folder / f"bare{round_}", size.durable)
            pairs.append((planrunner_steps(folder, size.durable, "durable", Probe()), bare))
        ratios = sorted(ours / bare for ours, bare in pairs)
        figures["durable, one Parquet file per step [steps/s]"] = max(ours for ours, _ in pairs)
        figures["bare loop with the same writes [steps/s]"] = max(bare for _, bare in pairs)
        figures[f"durable / bare loop, median of {size.pairs} pairs (target ≥ 0.5)"] = ratios[size.pairs // 2]
        figures |= peer("OpenHTF", openhtf_steps, folder, size.peers)
        figures |= peer("bluesky", bluesky_steps, folder, size.peers)
    return figures
