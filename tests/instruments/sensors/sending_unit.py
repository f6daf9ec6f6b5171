"""A sensor at the far end of a pseudo-terminal that sends in real time; what the line cannot take is dropped, as a UART does."""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Callable
from typing import Self


class SendingUnit:
    """frames(first, end): the bytes of frames first … end − 1, of which `rate` come a second; heard: what was written to the unit."""

    def __init__(self, frames: Callable[[int, int], bytes], rate: float):
        self.frames, self.rate = frames, rate
        self.heard = b""
        self.silent = False
        self.dropped = 0
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()
        os.close(self._slave)

    def unplug(self) -> None:
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            os.close(self._master)

    def _send(self) -> None:
        begun, sent = time.monotonic(), 0
        while not self._ended.wait(0.003):
            due = int((time.monotonic() - begun) * self.rate)
            if due > sent and not self.silent:
                data = self.frames(sent, due)
                try:
                    self.dropped += len(data) - os.write(self._master, data)
                except BlockingIOError:
                    self.dropped += len(data)
            sent = due
            try:
                self.heard += os.read(self._master, 4096)
            except BlockingIOError:
                continue
