"""Compares the time to verify a run with large files of samples with the time to hash the same bytes, in one process."""

from __future__ import annotations

import hashlib
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planrunner.archive.run_folder import RunWriter
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Segment
from planrunner.tasks.verify import verify_run

CHANNELS = dict.fromkeys(("x", "y", "z"), "deg/s")


@dataclass(frozen=True, slots=True)
class Size:
    """samples: number of samples of each segment."""

    segments: int
    samples: int
    pairs: int


FULL, SMALL = Size(200, 100_000, 7), Size(3, 1000, 1)


def write(root: Path, size: Size) -> Path:
    rng = np.random.default_rng(1)
    with RunWriter.create(root, "p", b"plan", b"bench", {}, "flushed") as writer:
        for index in range(size.segments):
            segment = Segment(index, f"P{index + 1}", None, "unknown", Rest(), dwell=1.0)
            writer.begin(segment, float(index), CHANNELS)
            time_s = index + np.arange(size.samples) / size.samples
            writer.append(Block(time_s, {name: rng.normal(size=size.samples) for name in CHANNELS}), index + 1.0)
            writer.acknowledge(index + 1.0, {}, {})
        writer.finish()
    return writer.path


def hashed(run: Path) -> int:
    """Computes the SHA-256 of every file of the run, as `sha256sum` does. Returns the number of bytes."""
    count = 0
    for path in run.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                hashlib.file_digest(file, "sha256")
            count += path.stat().st_size
    return count


def run(size: Size = FULL) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        made = write(Path(folder), size)
        count = hashed(made)
        assert not verify_run(made).changes
        ours, bare = [], []
        for _ in range(size.pairs):
            begin = time.perf_counter()
            verify_run(made)
            middle = time.perf_counter()
            hashed(made)
            ours.append(middle - begin)
            bare.append(time.perf_counter() - middle)
    ratio = statistics.median(one / other for one, other in zip(ours, bare, strict=True))
    return {
        "size of the run [MB]": count / 1e6,
        f"verify, {size.segments} files of samples [s]": statistics.median(ours),
        "SHA-256 of the same bytes [s]": statistics.median(bare),
        f"verify / SHA-256, median of {size.pairs} pairs (target ≤ 2)": ratio,
    }
