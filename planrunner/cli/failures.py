"""Failures of commands: their exit codes, their texts on the terminal, and their findings for `--json`."""

from __future__ import annotations

import sys
import tempfile
import traceback
from dataclasses import dataclass, replace

from planrunner.base.findings import COMMAND_LINE, Finding, InputError, Mark
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_findings


@dataclass(frozen=True, slots=True)
class CommandFailure:
    """A failure of a command. `text`: text that is printed on the terminal instead of the findings, because it contains more than
    the findings. `trace`: traceback of an unexpected exception, until it has been saved (see `saved`)."""

    code: int
    findings: tuple[Finding, ...]
    text: str = ""
    trace: str = ""

    def saved(self) -> CommandFailure:
        """Saves the traceback, if there is one, in a temporary file; returns the failure with a message that names the file."""
        if not self.trace:
            return self
        with tempfile.NamedTemporaryFile(
            "w", prefix="planrunner-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(self.trace)
        hint = f"Please report it with the file {file.name}."
        (finding,) = self.findings
        return CommandFailure(self.code, (replace(finding, hint=hint),), f"{self.text}\n{hint}")

    def show(self) -> None:
        """Prints the failure to standard error."""
        if self.text:
            print(self.text, file=sys.stderr)
        else:
            print_findings(self.findings)


@dataclass(frozen=True, slots=True)
class _Known:
    """A kind of failure: its exit code and the code of its finding."""

    exit_code: int
    code: str


_KINDS = {
    "IntegrityError": _Known(exit_codes.INTEGRITY, "run-integrity"),
    "NotOrdinaryError": _Known(exit_codes.INTEGRITY, "run-integrity"),
    "ProcessEndedError": _Known(exit_codes.FAULT, "process-ended"),
    "InstrumentError": _Known(exit_codes.FAULT, "run-instrument"),
    "EstimationError": _Known(exit_codes.WRONG_INPUT, "estimate-failed"),
    "ReportError": _Known(exit_codes.WRONG_INPUT, "report-failed"),
    "ExportError": _Known(exit_codes.WRONG_INPUT, "export-failed"),
}
_SYSTEM = _Known(exit_codes.WRONG_INPUT, "file-system")
_INTERNAL = _Known(exit_codes.FAULT, "internal-error")


def failure_of(error: Exception) -> CommandFailure:
    """Returns the failure that reports an exception. The traceback of an unexpected exception is saved in a temporary file, which
    the message names."""
    return unsaved_failure_of(error, COMMAND_LINE.file).saved()


def unsaved_failure_of(error: Exception, where: str) -> CommandFailure:
    """Does the same as `failure_of`, but no file is written, so that a worker on another computer can call it."""
    if isinstance(error, InputError):
        return CommandFailure(exit_codes.WRONG_INPUT, tuple(error.findings))
    for kind in type(error).__mro__:
        known = _KINDS.get(kind.__name__)
        if known is not None:
            said = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
            return _failure(known, where, said)
    if isinstance(error, OSError):
        place = str(error.filename or where)
        reason = error.strerror or str(error)
        return _failure(_SYSTEM, place, reason, f"{error.filename}: {reason}" if error.filename else reason)
    message, trace = f"{type(error).__name__}: {error}", "".join(traceback.format_exception(error))
    finding = Finding(Mark(where), _INTERNAL.code, "error", message)
    return CommandFailure(_INTERNAL.exit_code, (finding,), f"internal error: {message}", trace)


def _failure(known: _Known, where: str, message: str, shown: str = "") -> CommandFailure:
    return CommandFailure(
        known.exit_code, (Finding(Mark(where), known.code, "error", message),), f"error: {shown or message}"
    )
