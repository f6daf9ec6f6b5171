"""Reading ahead: files are read and unpacked in a thread of their own while what came before is worked on.

Both give up the interpreter for most of their time, so that on two cores an analysis takes about as long as the slower of the two.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator

from planrunner.instruments.interfaces import Block

AHEAD = 2  # blocks that wait; memory does not grow beyond them

Item = Block | BaseException | None


def read_ahead(blocks: Iterable[Block]) -> Iterator[Block]:
    """The same blocks in the same order. What reading raises is raised here; whoever stops early ends the reading too."""
    waiting: queue.Queue[Item] = queue.Queue(AHEAD)
    stopped = threading.Event()

    def offer(item: Item) -> bool:
        while not stopped.is_set():
            try:
                waiting.put(item, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False

    def read() -> None:
        try:
            for block in blocks:
                if not offer(block):
                    return
            offer(None)
        except BaseException as error:  # raised again where the blocks are used
            offer(error)

    reader = threading.Thread(target=read, name="read-ahead", daemon=True)
    reader.start()
    try:
        while (item := waiting.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stopped.set()
        reader.join()
