"""Defines type aliases for arrays of real numbers and of integers. A function that takes or returns an array states the shape and
unit of the array in its docstring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
