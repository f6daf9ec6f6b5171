"""The outcome of executing a schedule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planrunner.base.findings import Finding
from planrunner.instruments.interfaces import InstrumentError


@dataclass(frozen=True, slots=True)
class Failure:
    """A failure of a run.

    `where`: what the executor was doing. `kind`: the class of the exception. `message`: text for a quality engineer.
    """

    where: str
    kind: str
    message: str

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"

    @classmethod
    def of(cls, error: BaseException, where: str) -> Failure:
        kind = type(error).__name__
        if isinstance(error, InstrumentError):
            message = str(error)
        elif isinstance(error, OSError) and error.strerror:
            message = f"{error.strerror}{f' ({error.filename})' if error.filename else ''}"
        else:
            message = f"{kind}: {error}" if str(error) else kind
        return cls(where, kind, message)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of executing a schedule.

    `completed`: number of segments acknowledged in this execution. `segments`: number of segments in the schedule. `stopped`: how
    the operator stopped the run; None if the operator did not stop it. `unsafe`: failures in making instruments safe. `untouched`:
    instruments that were never commanded, and are therefore left as they were. `finished`: True if every segment is acknowledged
    and the folder is sealed. `remarks`: information that the user needs even if the run is complete. `unsigned`: the reason why the
    bench did not sign the seal although it should have.
    """

    completed: int
    segments: int
    finished: bool
    stopped: Literal["after the segment", "at once"] | None = None
    failures: tuple[Failure, ...] = ()
    unsafe: tuple[str, ...] = ()
    untouched: tuple[str, ...] = ()
    remarks: tuple[Finding, ...] = ()
    unsigned: tuple[Finding, ...] = ()

    @property
    def ok(self) -> bool:
        return self.finished and not self.failures and not self.unsafe
