"""Handles the state that a run needs to continue after a crash. This state consists of the states of the simulated instruments and
of the executor, and is stored with every segment.

On a real bench, nothing is stored, because the state of real instruments cannot be restored from data. After an interruption,
nothing is assumed about their state.
"""

from __future__ import annotations

import numpy as np

from planrunner.archive.resuming import ResumePoint
from planrunner.base.documents import JsonObject
from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.reaching import Reaching
from planrunner.instruments.interfaces import Resumable


class Continuity:
    """Reads and restores the states from which a run can continue: the states of the bench's simulated instruments, and the state
    of the executor (held in `reaching`)."""

    def __init__(self, bench: ConnectedBench, reaching: Reaching):
        self._bench = bench
        self._reaching = reaching
        self._resumable = {name: item for name, item in bench.instruments.items() if isinstance(item, Resumable)}

    def states(self) -> JsonObject:
        """Returns the states of the simulated instruments and of the executor as JSON data; empty on a real bench."""
        if not self._resumable:
            return {}
        reaching, attitude = self._reaching, self._reaching.attitude
        executor = {
            "temperature": reaching.temperature,
            "attitude": None if attitude is None else attitude.tolist(),
            "soak_again": reaching.soak_again,
            "mode": reaching.mode,
            "mode_since": reaching.mode_since,
            "moving_perhaps": reaching.moving_perhaps,
        }
        return {
            "executor": executor,
            "instruments": {name: item.checkpoint() for name, item in self._resumable.items()},
        }

    def states_if_known(self) -> JsonObject:
        """Does the same as `states` after a failure. The result is empty if a driver that has failed does not know its state."""
        self._reaching.forget()
        try:
            return self.states()
        except BaseException:  # a driver that has failed may not know its state
            return {}

    def restore(self, point: ResumePoint) -> None:
        """Restores the states that were stored before the run was interrupted."""
        self._bench.clock.set(point.clock)
        self._reaching.forget()
        # Simulated instruments get back their exact state; without an acknowledged segment they start anew.
        simulated_table = isinstance(self._bench.table, Resumable)
        simulated_chamber = isinstance(self._bench.chamber, Resumable)
        self._reaching.moving_perhaps = not simulated_table
        if not point.states:
            return
        executor, instruments = point.states["executor"], point.states["instruments"]
        for name, item in self._resumable.items():
            if name in instruments:
                item.restore(instruments[name])
        if simulated_table:
            attitude = executor["attitude"]
            self._reaching.attitude = None if attitude is None else np.array(attitude, dtype=np.float64)
            self._reaching.moving_perhaps = executor["moving_perhaps"]
        if isinstance(self._bench.sensor, Resumable):
            self._reaching.mode = executor["mode"]
            self._reaching.mode_since = executor.get("mode_since")
        if simulated_chamber:
            self._reaching.temperature, self._reaching.soak_again = executor["temperature"], executor["soak_again"]
