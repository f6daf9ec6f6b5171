"""A run folder as a running process has it: locked, with a live state that a test sets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planrunner.archive.live import LiveChannel, LiveState, Question, Strip, publish, withdraw
from planrunner.archive.run_folder import RunWriter

HOSTILE = "<img src=x onerror=\"document.title='broken'\">\u202e\x1b[2J'\"&amp;</script><script>document.title='broken'</script>"
QUESTION = Question("0123456789abcdef", f"Mount face B, {HOSTILE}")
CHANNELS = tuple(
    LiveChannel(
        name,
        "deg/s",
        1000,
        0.001,
        0.02,
        -0.06,
        0.07,
        Strip(tuple([-0.06] * 30), tuple(0.001 * k for k in range(30)), tuple([0.07] * 30)),
    )
    for name in ("rate_x", HOSTILE)
)
STATE = LiveState(
    "2026-03-01T12:00:00.000000+00:00", 2, "P3", 8, 0.25, 90.0, "recording", False, None, CHANNELS,
    tuple(float(k) for k in range(30)), 0, (),
)  # fmt: skip


MADE: list[RunWriter] = []


def close_all() -> None:
    """At the end of a test: everything that it opened."""
    while MADE:
        MADE.pop().close()


class RunningRun:
    """The run of a plan in `archive`. Every state has a time of its own, as those of a process have."""

    def __init__(self, archive: Path, plan: str = "drift", device: str = "FG-7"):
        self.writer = RunWriter.create(
            archive, plan, b"", b"", {"device_serial": device, "operator": "night"}, "flushed"
        )
        MADE.append(self.writer)
        self.path = self.writer.path
        self.number = 0
        self.show()

    def show(self, **changes: object) -> None:
        self.number += 1
        at = f"2026-03-01T12:00:00.{self.number:06d}+00:00"
        publish(self.writer.folder, replace(STATE, at=at, **changes))  # type: ignore[arg-type]

    def end(self) -> None:
        withdraw(self.writer.folder)
        self.writer.finish()
        self.writer.close()
