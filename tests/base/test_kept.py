"""Kept results: computed once for equal content, shared read-only, and limited in number and size."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Both:
    one: Array
    other: tuple[Array, ...]


def test_equal_content_is_computed_once_and_other_content_again() -> None:
    calls: list[str] = []

    @kept(8)
    def doubled(array: Array, parts: tuple[Array, str], power: int = 1) -> Array:
        calls.append(parts[1])
        return 2 * array**power + parts[0]

    array, part = np.arange(3.0), np.ones(3)
    first = doubled(array, (part, "a"))
    assert doubled(array.copy(), (part.copy(), "a")) is first
    assert calls == ["a"]
    array[0] = 7.0  # the content counts, not the object
    assert doubled(array, (part, "a"))[0] == 15.0
    assert doubled(array, (2 * part, "a"))[0] == 16.0
    assert doubled(array, (part, "a"), power=2)[0] == 99.0
    assert doubled(array.reshape(1, 3), (part, "a")).shape == (1, 3)
    assert len(calls) == 5


def test_shared_arrays_cannot_be_changed() -> None:
    @kept(8)
    def both(array: Array) -> Both:
        return Both(array + 1, (array + 2,))

    found = both(np.zeros(2))
    for array in (found.one, *found.other):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_the_oldest_results_and_large_ones_are_not_kept() -> None:
    calls: list[int] = []

    @kept(2)
    def sized(n: int) -> Array:
        calls.append(n)
        return np.zeros(n)

    for n in (1, 2, 3, 2, 1):
        sized(n)
    assert calls == [1, 2, 3, 1]
    for _ in range(2):
        sized(1_000_000)
    assert calls[4:] == [1_000_000, 1_000_000]


def test_an_error_is_raised_again() -> None:
    @kept(8)
    def refused(name: str) -> Array:
        raise ValueError(name)

    for _ in range(2):
        with pytest.raises(ValueError, match="a"):
            refused("a")
