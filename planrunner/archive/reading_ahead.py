"""Reading one file ahead: while the samples of a file are being used, the next file is read and its digest is checked in another thread.

Reading and hashing release the interpreter's lock, so both happen at the same time. At most one file waits, so that memory does not
grow with the recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

T = TypeVar("T")


def ahead(items: Iterator[T]) -> Iterator[T]:
    """The same items in the same order. Each item is made while the one before it is used. An exception in `items` is raised where
    its item would be."""
    from concurrent.futures import ThreadPoolExecutor

    end = object()
    with ThreadPoolExecutor(1, "reading ahead") as reader:
        following = reader.submit(next, items, end)
        while (item := following.result()) is not end:
            following = reader.submit(next, items, end)
            yield item  # type: ignore[misc]  # it is not the end
            item = None
