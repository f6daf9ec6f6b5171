"""Converts fields of frames to columns: integers of one to eight bytes, floats and fixed-point numbers, in either byte order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.instruments.wire.codes import SIGNED
from planrunner.instruments.wire.framing import Frames


@dataclass(frozen=True, slots=True)
class Field:
    """Describes a number at the byte `offset` of every frame. The value of the number is the encoded number multiplied by `scale`.
    `kind`: UNSIGNED or SIGNED with a `width` of 1 to 8 bytes; FLOAT with a width of 4 or 8; or FRACTION_FIRST (32 bits of the
    fraction, then 16 bits of the integer). Integers are exact up to 53 bits; with `whole_numbers`, up to 64 bits."""

    offset: int
    width: int
    kind: int = SIGNED
    scale: float = 1.0
    little: bool = False


def numbers(frames: Frames, fields: Sequence[Field]) -> NDArray[np.float64]:
    """Returns the scaled values of the fields in all frames, shape (fields, frames)."""
    from planrunner.instruments.wire.kernels import scaled

    places = np.array([(item.offset, item.width, item.kind, item.little) for item in fields], np.int64).reshape(-1, 4)
    scales = np.array([item.scale for item in fields], float)
    found: NDArray[np.float64] = scaled(frames.data, frames.starts, places, scales)
    return found


def whole_numbers(frames: Frames, item: Field) -> NDArray[np.int64]:
    """Returns the values of an integer field without its scale, shape (n,). Unsigned values of eight bytes wrap at 2⁶³."""
    from planrunner.instruments.wire.kernels import bits

    found: NDArray[np.int64] = bits(
        frames.data, frames.starts, item.offset, item.width, item.kind == SIGNED, item.little
    )
    return found


def alike(frames: Frames, places: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Compares the bytes at `places` in each frame with those in the first frame. Returns True for each frame in which they are
    equal. `places` are counted from the start of a frame. Every frame must be long enough to contain the bytes at all `places`."""
    from planrunner.instruments.wire import kernels

    found: NDArray[np.bool_] = kernels.alike(frames.data, frames.starts, places)
    return found
