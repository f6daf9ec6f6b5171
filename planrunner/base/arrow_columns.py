"""Converts columns of numbers between numpy and pyarrow without pandas.

If pandas is installed, pyarrow's own conversions to and from numpy import pandas to recognise its types. This import takes half a
second in every command that reads or writes samples. The conversions of this module use buffers and DLPack, which do not import
pandas.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow as pa


def column(values: NDArray[np.float64]) -> pa.Array:
    """Makes a `pyarrow.Array` of numbers (n,). Contiguous numbers are not copied; the array shares their memory."""
    import pyarrow as pa

    whole = np.ascontiguousarray(values, dtype=np.float64)
    return pa.Array.from_buffers(pa.float64(), len(whole), [None, pa.py_buffer(whole)])


def numbers(values: pa.Array) -> NDArray[np.float64]:
    """Converts a `pyarrow.Array` of 64-bit floats to an array (n,), in which a missing number is NaN. The array may be read-only."""
    return np.asarray(np.from_dlpack(values.fill_null(math.nan) if values.null_count else values), dtype=np.float64)
