"""Measures how much longer reading 10⁸ samples × 3 channels with statistics takes if the samples are also screened."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measuring import Figures, counted, figures_of, peak_memory
from benchmarks.recording_memory import CHANNELS, RATE, blocks
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.observation.screening import watch_of
from planrunner.plan.schedule import Rest, Schedule, Segment

SENSOR = SensorModel("bench", tuple(OutputModel(name, unit) for name, unit in CHANNELS.items()), RATE)


@dataclass(frozen=True, slots=True)
class Size:
    samples: int
    rounds: int = 3
    separate: bool = True


FULL, SMALL = Size(10**8), Size(3 * 10**5, rounds=1, separate=False)


def read(samples: int, rounds: int) -> Figures:
    """Reads samples with statistics, without and with screening. Returns the medians of the two processor times [s], the number of
    finds, and the peak memory [MB]."""
    segment = Segment(0, "long", np.eye(3), "as built", Rest(), samples / RATE)
    schedule = Schedule((segment,), samples / RATE)
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        with RunWriter.create(Path(folder), "screening", b"", b"", {}, "flushed") as writer:
            writer.begin(segment, 0.0, CHANNELS)
            for block in blocks(samples):
                writer.append(block, 0.0)
            writer.acknowledge(0.0, {}, {})
            writer.finish()
        run = RunReader.open(writer.path)

        def plainly() -> None:
            run.recording(schedule)

        def screened() -> None:
            nonlocal found
            (long,) = run.recording(schedule, watch_of(SENSOR))
            found = len(long.finds or ())

        alone, beside = [], []
        for _ in range(rounds):
            alone.append(_seconds(plainly))
            beside.append(_seconds(screened))
    return {
        "alone": float(np.median(alone)),
        "screened": float(np.median(beside)),
        "finds": found,
        "peak": peak_memory(),
    }


def _seconds(do: Callable[[], None]) -> float:
    began = time.process_time()
    do()
    return time.process_time() - began


def run(size: Size = FULL) -> dict[str, object]:
    known = figures_of(read, size.samples, size.rounds, separate=size.separate)
    rows = counted(size.samples)
    return {
        f"reading {rows} samples with statistics [s of processor time]": known["alone"],
        "reading with statistics and screening [s of processor time]": known["screened"],
        "ratio (target ≤ 1.2)": known["screened"] / known["alone"],
        "outliers found in white noise (target 0)": known["finds"],
        "peak memory [MB]": known["peak"],
    }
