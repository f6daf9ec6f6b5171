"""What goes wrong with frames between a sensor and the computer: corrupted, lost, doubled, out of order, read at another baud rate, or
those of another instrument."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.simulators.columns import Bytes
from planrunner.simulators.faults import Fault

_COMPASS = b"$HEHDT,274.07,T*03\r\n"
"""What a heading sensor says."""


def struck(frames: Bytes, faults: Sequence[Fault], draw: np.random.Generator) -> Bytes:
    """The frames (n, length) as they leave under the faults that stand."""
    for fault in faults:
        if not len(frames):
            return frames
        chosen = draw.random(len(frames)) < fault.share.value
        if fault.fault == "silent":
            return frames[:0]
        if fault.fault == "lose":
            frames = frames[~chosen]
        elif fault.fault == "duplicate":
            frames = np.repeat(frames, 1 + chosen, axis=0)
        elif fault.fault == "reorder":
            frames = frames[np.argsort(np.arange(len(frames)) + 1.5 * chosen, kind="stable")]
        elif fault.fault == "corrupt":
            frames = _corrupted(frames, np.flatnonzero(chosen), draw)
        elif fault.fault == "wrong baud":
            frames = _misread(frames)
        elif fault.fault == "wrong model":
            frames = np.tile(np.frombuffer(_COMPASS, np.uint8), (len(frames), 1))
    return frames


def _corrupted(frames: Bytes, rows: np.ndarray, draw: np.random.Generator) -> Bytes:
    """One byte of each chosen frame is another."""
    changed = frames.copy()
    places = draw.integers(0, frames.shape[1], rows.size)
    changed[rows, places] ^= draw.integers(1, 256, rows.size).astype(np.uint8)
    return changed


def _misread(frames: Bytes) -> Bytes:
    """Every bit is read twice as fast as it is sent: each byte becomes two, of doubled bits."""
    bits = np.unpackbits(frames, axis=1, bitorder="little")
    return np.packbits(np.repeat(bits, 2, axis=1), axis=1, bitorder="little")
