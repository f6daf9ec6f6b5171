"""Computes the disk space that a run needs, and checks it before anything moves."""

from __future__ import annotations

import shutil
from pathlib import Path

from planrunner.base.findings import InputError, Mark
from planrunner.plan.schedule import Schedule

BYTES_A_VALUE = 8
OVERHEAD = 1.1  # Parquet's headers and footers, and noise that does not compress
BYTES_A_SEGMENT = 16_384  # journal lines with the state of simulated instruments, and the file's footer
RESERVE = 16 * 2**20  # analyses and reports


def recording_bytes(schedule: Schedule, sample_rate: float, channels: int) -> int:
    """Returns the largest number of bytes that a run of `schedule` can write.

    `sample_rate`: sample rate of the sensor, Hz, for segments that do not state a sample rate. `channels`: number of columns, not
    counting the time. A segment whose length is determined by a recording that is played back counts as zero.
    """
    values = sum(
        (segment.dwell or 0.0) * (segment.sample_rate or sample_rate) * (channels + 1) for segment in schedule.segments
    )
    return int(values * BYTES_A_VALUE * OVERHEAD) + BYTES_A_SEGMENT * len(schedule.segments) + RESERVE


def require_space(folder: Path, needed: int) -> None:
    """Raises `InputError` if the disk that holds `folder` (or its nearest existing parent) has less than `needed` bytes."""
    missing = shortage(folder, needed)
    if missing:
        message = f"the run {missing}"
        raise InputError.at(
            Mark(str(folder)), "disk-space", message, "free disk space, or choose another folder for runs"
        )


def shortage(folder: Path, needed: int) -> str:
    """Returns the end of a sentence about a disk that has less than `needed` bytes, such as "needs up to 2 GB, …"; empty if the
    disk has enough room."""
    existing = next((place for place in (folder, *folder.absolute().parents) if place.exists()), Path.cwd())
    free = shutil.disk_usage(existing).free
    return "" if free >= needed else f"needs up to {_size(needed)}, but the disk has only {_size(free)} free"


def _size(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"
