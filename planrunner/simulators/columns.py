"""Numbers as columns of bytes, the form in which a sensor's frames are put together: one row a frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Values = NDArray[np.floating | np.integer]
"""Readings, real or whole."""
Order = Literal["big", "little"]


def integers(
    values: NDArray[np.generic] | Sequence[float], width: int, order: Order = "big", signed: bool = True
) -> Bytes:
    """Whole numbers (n,) as (n, width) bytes, in two's complement; what does not fit stays at the end of the range."""
    bits = 8 * width
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    whole = np.asarray(values)
    if whole.dtype.kind == "f":
        whole = np.rint(np.nan_to_num(whole))
    whole = np.clip(whole, low, high).astype(np.int64 if signed or bits < 64 else np.uint64)
    places = np.arange(width - 1, -1, -1) if order == "big" else np.arange(width)
    shifts = (8 * places).astype(whole.dtype)  # numpy shifts unsigned numbers of 64 bits by their like only
    parts: NDArray[np.uint8] = ((whole[:, None] >> shifts) & whole.dtype.type(0xFF)).astype(np.uint8)
    return parts


def floats(values: NDArray[np.generic] | Sequence[float], width: int = 4, order: Order = "big") -> Bytes:
    """IEEE 754 numbers (n,) of 4 or 8 bytes as (n, width)."""
    kind = ("<" if order == "little" else ">") + f"f{width}"
    return np.ascontiguousarray(values, dtype=kind).reshape(-1, 1).view(np.uint8)


def constant(data: bytes, count: int) -> Bytes:
    """The same bytes in every row."""
    return np.broadcast_to(np.frombuffer(data, dtype=np.uint8), (count, len(data)))


def joined(*parts: Bytes) -> Bytes:
    """Columns side by side."""
    return np.concatenate(parts, axis=1)
