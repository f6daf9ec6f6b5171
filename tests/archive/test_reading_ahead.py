"""Reading one item ahead: order, exceptions, the bound, and the end of the thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from planrunner.archive.run_reader import ahead


def counted(made: list[int], count: int = 5) -> Iterator[int]:
    for number in range(count):
        made.append(number)
        yield number


def test_items_come_in_order() -> None:
    assert list(ahead(counted([]))) == [0, 1, 2, 3, 4]
    assert list(ahead(counted([], 0))) == []


def test_the_next_item_is_made_while_one_is_used_and_no_other() -> None:
    made: list[int] = []
    begun = threading.Event()

    def watched() -> Iterator[int]:
        for number in counted(made):
            if number == 2:
                begun.set()
            yield number

    read = ahead(watched())
    assert next(read) == 0
    assert next(read) == 1
    assert begun.wait(300)  # without being asked for
    assert made == [0, 1, 2]
    read.close()  # type: ignore[attr-defined]


def test_an_exception_comes_where_its_item_would_be() -> None:
    def failing() -> Iterator[int]:
        yield 0
        raise OSError("gone")

    read = ahead(failing())
    assert next(read) == 0
    with pytest.raises(OSError, match="gone"):
        next(read)


def test_no_thread_is_left_if_reading_is_given_up() -> None:
    before = threading.active_count()
    read = ahead(counted([]))
    assert next(read) == 0
    assert threading.active_count() == before + 1
    read.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before
