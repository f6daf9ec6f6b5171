"""Type aliases for arrays of real numbers and of integers. The functions that take or return an array state its shape and units in
their docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
