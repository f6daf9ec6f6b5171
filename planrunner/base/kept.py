"""Caches results of pure functions for later calls with the same content.

Plans of a laboratory often have the same bench, site and positions, and a plan uses the same positions in several estimates. A
result that depends only on such data is computed once per process. Arrays are compared by their bytes, so a cached result is
returned only for an equal input.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import wraps
from threading import Lock
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

_LARGEST = 50_000  # bytes of the arrays in one call and its result; larger ones are not worth their memory


def kept(most: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Caches the last `most` results of a function. The arguments of the function must be arrays, hashable values and tuples of
    these, and its result must depend on nothing else.

    Arrays in a result (an array, a record of arrays, or a tuple of these) are made read-only, because callers share them.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        results: dict[object, R] = {}
        lock = Lock()

        @wraps(function)
        def call(*given: P.args, **named: P.kwargs) -> R:
            key = _content((*given, *named.items()))
            if key in results:
                return results[key]
            found = function(*given, **named)
            arrays = _arrays(found)
            for array in arrays:
                array.flags.writeable = False
            if sum(array.nbytes for array in (*arrays, *_arrays(given))) <= _LARGEST:
                with lock:
                    while len(results) >= most:
                        del results[next(iter(results))]
                    results[key] = found
            return found

        return call

    return decorate


def _content(given: object) -> object:
    if isinstance(given, tuple):
        return tuple([_content(one) for one in given])
    if isinstance(given, np.ndarray):
        return given.shape, given.dtype.char, given.tobytes()
    return given


def _arrays(found: object) -> list[NDArray[np.generic]]:
    if isinstance(found, np.ndarray):
        return [found]
    if isinstance(found, tuple):
        return [array for one in found for array in _arrays(one)]
    if dataclasses.is_dataclass(found):
        return [array for item in dataclasses.fields(found) for array in _arrays(getattr(found, item.name))]
    return []
