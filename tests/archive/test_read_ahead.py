"""Reading ahead: the same blocks, errors where they are used, no thread left behind, no more memory than a few blocks."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from planrunner.archive.read_ahead import AHEAD, read_ahead
from planrunner.instruments.interfaces import Block


def block(number: int) -> Block:
    return Block(np.array([float(number)]), {"x": np.array([float(number)])})


def threads() -> list[str]:
    return [one.name for one in threading.enumerate() if one.name == "read-ahead"]


def test_the_same_blocks_in_order() -> None:
    assert [one.time[0] for one in read_ahead(block(k) for k in range(50))] == list(range(50))
    assert list(read_ahead(())) == []
    assert not threads()


def test_an_error_comes_after_what_was_read_before_it() -> None:
    def broken() -> Iterator[Block]:
        yield block(0)
        raise OSError("gone")

    blocks = read_ahead(broken())
    assert next(blocks).time[0] == 0.0
    with pytest.raises(OSError, match="gone"):
        next(blocks)
    assert not threads()


def test_who_stops_early_ends_the_reading_and_little_was_read_ahead() -> None:
    made = []

    def endless() -> Iterator[Block]:
        while True:
            made.append(len(made))
            yield block(len(made))

    blocks = read_ahead(endless())
    next(blocks)
    blocks.close()  # type: ignore[attr-defined]
    assert not threads()
    assert len(made) <= AHEAD + 3
