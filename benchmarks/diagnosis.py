"""Measures time and memory of a diagnosis of six channels with all installed effects and their pairs.

The second diagnosis in a process is timed, so that the time does not include loading libraries. Linear algebra uses one thread. Long
recordings are drawn and read in blocks, and the time includes this: `python -m benchmarks.diagnosis 100000000 long`. A third
argument, such as 6, repeats the plan of 41 segments.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks.measuring import Figures, figures_of, peak_memory


@dataclass(frozen=True, slots=True)
class Size:
    samples: tuple[int, ...]
    separate: bool = True


FULL, SMALL = Size((25_000, 100_000, 400_000)), Size((2_000,), separate=False)


def measure(samples: int, repeats: int = 1) -> Figures:
    """Returns the elapsed time [s] and the processor time [s] of the second diagnosis, and the peak memory [MB]. `repeats`: how often
    the plan is carried out."""
    from planrunner.gap.answer.diagnosis import diagnose
    from tests.gap.turntable import plan, record

    diagnose(record())
    observed = record(seed=2, sampling=samples / (repeats * sum(row[2] for row in plan())), repeats=repeats)
    began, worked = time.perf_counter(), time.process_time()
    diagnose(observed)
    figures = {"wall": time.perf_counter() - began, "cpu": time.process_time() - worked, "samples": len(observed.time)}
    figures["segments"] = len(observed)
    return figures | {"peak": peak_memory()}


def measure_long(samples: int, repeats: int = 1) -> Figures:
    """Measures the diagnosis of a recording at 200 Hz. The segments at rest are as long as the number of samples requires. The
    samples are drawn while they are read, so they are never stored."""
    import numpy as np

    from planrunner.archive.recording import RecordedSegment
    from planrunner.archive.statistics import statistics_of
    from planrunner.gap.answer.diagnosis import diagnose
    from planrunner.instruments.interfaces import Block
    from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
    from planrunner.observation.samples import observed
    from planrunner.plan.schedule import Rest, Segment
    from tests.gap.turntable import SITE, record

    seen, rate = record(seed=2, sampling=200.0, repeats=repeats), 200.0
    outputs = tuple(
        OutputModel(c.name, c.unit, noise=NoiseModel(c.white / c.factor, 0.0, c.resolution / c.factor))
        for c in seen.channels
    )
    still = [isinstance(motion, Rest) for motion in seen.motions]
    lasting = (samples - sum(p.stop - p.start for p, s in zip(seen.segments(), still, strict=True) if not s)) // sum(
        still
    )
    units, factor = {c.name: c.unit for c in seen.channels}, np.array([c.factor for c in seen.channels])
    noise, count = (np.array([getattr(c, name) for c in seen.channels]) / factor for name in ("white", "resolution"))
    parts, attitude, motions = seen.segments(), seen.attitude, seen.motions
    model = [
        (own.mean(0)[None] if rests else own) / factor
        for own, rests in zip((seen.values[part] for part in parts), still, strict=True)
    ]
    del seen  # its samples would count as memory of the diagnosis

    def segment(index: int, part: slice, start: float) -> RecordedSegment:
        rows = lasting if still[index] else part.stop - part.start

        def blocks(names: Sequence[str]) -> Iterator[Block]:
            draw = np.random.default_rng(index)
            for first in range(0, rows, 65_536):
                n = min(65_536, rows - first)
                values = model[index][first : first + n]
                if still[index]:
                    values = model[index] + draw.standard_normal((n, 6)) * noise * np.sqrt(rate)
                    values = np.round(values / count) * count
                columns = dict(zip(units, values.T, strict=True))
                yield Block(start + (first + np.arange(n)) / rate, {name: columns[name] for name in names})

        made = Segment(index, f"S{index}", attitude[index], "", motions[index], rows / rate, temperature=298.15)
        return RecordedSegment(made, units, statistics_of(blocks(tuple(units)), tuple(units), rows), blocks)

    began, worked, start, made = time.perf_counter(), time.process_time(), 600.0, []
    for index, part in enumerate(parts):
        made.append(segment(index, part, start))
        start = made[-1].statistics.end + 20.0
    found = observed(made, SITE, SensorModel("imu", outputs, rate))
    read = time.process_time() - worked
    diagnose(found)
    figures = {
        "wall": time.perf_counter() - began,
        "cpu": time.process_time() - worked,
        "read": read,
        "bins": len(found.time),
        "segments": len(found),
    }
    figures["samples"] = sum(item.statistics.count for item in made)
    return figures | {"peak": peak_memory()}


def run(size: Size = FULL) -> dict[str, object]:
    found: dict[str, object] = {}
    for samples in size.samples:
        one_thread = {"OPENBLAS_NUM_THREADS": "1"}
        figures = figures_of(measure, samples, separate=size.separate, environment=one_thread)
        target = " (target ≤ 1)" if samples == 100_000 else ""
        found[f"{samples} samples × 6 channels, elapsed time [s]{target}"] = figures["wall"]
        found[f"{samples} samples × 6 channels, processor time [s]"] = figures["cpu"]
        found[f"{samples} samples × 6 channels, peak memory [MB]"] = figures["peak"]
    return found


if __name__ == "__main__":
    print((measure_long if "long" in sys.argv[2:] else measure)(*(int(one) for one in sys.argv[1:] if one != "long")))
