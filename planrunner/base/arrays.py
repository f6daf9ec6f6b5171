"""The type of arrays of real numbers. Their shapes and units are in the docstrings of the functions that take and return them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
