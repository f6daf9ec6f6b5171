"""Requests time stamps of a journal while events are added to it. A separate thread sends the requests to the authority, so that
the run never waits for the authority."""

from __future__ import annotations

import hashlib
import queue
import threading
import time
from collections.abc import Sequence

from planrunner.archive.run_folder import Witnessed
from planrunner.signing.time_stamps import StampAuthority, StampError, request_stamp

LAST_PATIENCE = 30.0
"""Time to wait for the time stamp of the end of a run, s."""


class Stamper:
    """The `Witness` that stamps the journal of one run. `every`: the shortest time between two requests, s."""

    def __init__(self, url: str, authority: StampAuthority, every: float):
        self._url, self._authority, self._every = url, authority, every
        self._arrived: queue.Queue[Witnessed] = queue.Queue()
        self._open: list[int] = []
        self._next = 0.0
        self.missed: list[str] = []
        """The reason for each missing time stamp."""

    def see(self, events: int, line: bytes, *, last: bool = False) -> None:
        now = time.monotonic()
        if not last and (self._open or now < self._next):  # one request at a time
            return
        self._next = now + self._every
        self._open.append(events)
        threading.Thread(target=self._request, args=(events, line), name="time stamp", daemon=True).start()

    def take(self, *, wait: bool = False) -> Sequence[Witnessed]:
        found: list[Witnessed] = []
        until = time.monotonic() + LAST_PATIENCE
        while self._open:
            try:
                one = (
                    self._arrived.get(timeout=max(until - time.monotonic(), 0)) if wait else self._arrived.get_nowait()
                )
            except queue.Empty:
                break
            if one.events in self._open:
                self._open.remove(one.events)
                found.append(one)
        if wait:
            why = f"the time stamp authority did not answer within {LAST_PATIENCE:g} s"
            found += [Witnessed(events, None, why=why) for events in self._open]
            self._open.clear()
        self.missed += [one.why for one in found if one.token is None]
        return found

    def _request(self, events: int, line: bytes) -> None:
        try:
            token, at = request_stamp(self._url, line, hashlib.sha256(line).hexdigest(), self._authority)
            self._arrived.put(Witnessed(events, token, at.isoformat()))
        except StampError as error:
            self._arrived.put(Witnessed(events, None, why=str(error)))
        except Exception as error:  # a stamp is never a reason to end a run
            self._arrived.put(Witnessed(events, None, why=f"{type(error).__name__}: {str(error)[:200]}"))
