"""The command line, with one module for each command. The module of a command contains only its arguments, its progress display and
the printing of its results.

A command's module is imported when the command is used, so that `check` stays quick. This package converts every failure to a
message and an exit code. The exit codes are: 0 done, 1 a limit failed or the data do not give an estimate, 2 the input is wrong, 3
a fault during execution, 4 a file was changed or damaged, 130 ended by a signal.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import io
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import NoReturn

from planrunner import __version__
from planrunner.base.dataclass import dataclass
from planrunner.base.exclusive import COMMAND
from planrunner.base.findings import InputError
from planrunner.base.interruption import Interruption
from planrunner.cli.exit_codes import DONE, WRONG_INPUT
from planrunner.reporting.printable import printable_streams

COMMANDS = {
    "check": "check plans and benches before anything moves",
    "show": "show a plan's timeline, positions, total time and predicted uncertainties",
    "diff": "show how two plans, benches or runs differ in meaning, and the consequences",
    "design": "find better positions, rates or cycles for a plan, and the theoretical bound",
    "run": "run a plan on a bench, then estimate and report",
    "night": "run a suite of plans unattended, or continue it where it stopped",
    "simulate": "run a plan on a virtual bench with effects of the catalogue added",
    "resume": "continue a run that was cut short or is paused, or record segments of it again",
    "pause": "pause a run before its next segment, with the bench in the safe state",
    "serve": "show the runs of an archive that are in progress, on a page in the browser where prompts are answered",
    "watch": "show the runs of an archive that are in progress, on the terminal",
    "site": "write a website about an archive (runs, devices, benches, coefficients over time) that opens without a server",
    "estimate": "estimate again from a recording, as a new analysis",
    "amend": "evaluate a run again for a stated reason, as a new analysis that names the person and the analysis it amends",
    "report": "write the reports of an analysis again",
    "review": "list what a reviewer must judge before a run is released, and write the review page",
    "runs": "list the runs of an archive, by device, plan, bench, verdict or date",
    "history": "show a coefficient of a device over time, with control charts, changes, drift and the next calibration",
    "compare": "compare the coefficients of several runs",
    "gauge": "show the repeatability and reproducibility of a coefficient over devices, operators and benches",
    "verify": "verify that run folders are as they were written, and report what was changed",
    "archive": "copy sealed runs to or from an archive on object storage",
    "approve": "approve a plan for benches with your key, withdraw approvals, or list them",
    "log": "begin the log of an archive, which shows removed and replaced runs; print its tree head, and make and verify proofs",
    "stamp": "add a time stamp to the seals of runs for which the authority did not answer",
    "sign": "sign a sealed run as reviewed, approved or released",
    "key": "make a key for signatures, show it, or add a public key to a key ring",
    "diagnose": "find where a recording differs from its simulation, which effect explains the difference, and what to measure "
    "next",
    "close": "diagnose, add the effects found to the simulation, simulate and compare, until no further effect "
    "can be named",
    "new": "list the shipped plans, or copy one to start from",
    "bench": "list benches and installed drivers, or check whether the instruments of a bench answer",
    "simulate-bench": "serve simulated instruments at the addresses of a bench, and inject faults",
    "export": "export coefficients to CSV, MATLAB, YAML or a C header",
    "self-test": "check this installation against reference data with known answers",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the `planrunner` command. Returns the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    _print_anything()
    with printable_streams(), COMMAND:
        return _main(arguments)


def _main(arguments: list[str]) -> int:
    asked = AnswerForm("--json" in arguments)
    with Interruption() as interruption:
        try:
            code = _run(arguments, asked)
            if sys.stdout is not None:
                sys.stdout.flush()  # a failure to write must show here, not while the interpreter ends
            return code
        except KeyboardInterrupt:
            return interruption.tell()
        except BrokenPipeError:
            _let_go_of_output()
            return DONE
        except SystemExit as stop:
            return stop.code if isinstance(stop.code, int) else WRONG_INPUT
        except Exception as error:
            if isinstance(error, OSError):
                _let_go_of_output()
            if interruption.reason:  # a library replaced the exception
                return interruption.tell()
            return _fail(error, as_json=asked.json)


@dataclass(slots=True)
class AnswerForm:
    """States the form of the output that the user requests. `json`: True if stdout must receive only JSON, even for errors."""

    json: bool


class _Parser(argparse.ArgumentParser):
    """An argument parser. With JSON output, it reports wrong usage as a finding; otherwise, it prints the usage and an error
    message."""

    asked = AnswerForm(False)

    def error(self, message: str) -> NoReturn:
        if self.asked.json:
            usage = " ".join(self.format_usage().split())
            raise InputError.of_usage(message, usage)
        self.print_usage(sys.stderr)
        self.exit(WRONG_INPUT, f"{self.prog}: error: {message}\n    hint: `{self.prog} --help` lists the arguments\n")


def _fail(error: Exception, *, as_json: bool) -> int:
    """Prints the failure as text on stderr and, with JSON output, as a list of findings on stdout. Returns the exit code."""
    from planrunner.cli.failures import failure_of
    from planrunner.cli.printing import print_json

    failure = failure_of(error)
    failure.show()
    if as_json:
        with contextlib.suppress(OSError):
            print_json([finding.to_json() for finding in failure.findings])
    return failure.code


def _let_go_of_output() -> None:
    """Discards output that could not be written. Otherwise, the interpreter would try to write it again at exit, and fail."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError, AttributeError):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_anything() -> None:
    """Makes the output streams accept all characters. A character that the encoding of the terminal lacks, such as °, is then shown
    as a code; otherwise it would end the command with an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _imported(name: str) -> ModuleType:
    """Imports a module and its dependencies. Garbage collection is off during the import, because modules are never freed."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        return import_module(name)
    finally:
        if collecting:
            gc.enable()


_ONE_THREAD = ("check", "show", "runs", "history", "compare", "gauge", "estimate", "verify")
"""Commands that run without the threads of OpenBLAS. In some commands, the matrices are so small that the start of threads costs
more time than it saves. Other commands compute with one thread, so that the digits of results do not depend on the number of
threads. A process without threads can also fork processes that share its work."""


def _start_no_threads(command: str) -> None:
    """Prevents numpy and pyarrow from starting threads that a command does not need, unless the user has set the options for these
    threads."""
    if command in _ONE_THREAD and "numpy" not in sys.modules:  # which reads it when it is imported
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")


def _run(arguments: list[str], asked: AnswerForm) -> int:
    _Parser.asked = asked
    parser = _Parser(
        prog="planrunner",
        description="Declarative test plans for inertial sensors.",
        epilog="`planrunner COMMAND --help` explains a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"planrunner {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((word for word in arguments if not word.startswith("-")), None)
    # The others are listed in the help, and where no command comes first.
    named = [chosen] if chosen in COMMANDS and arguments[0] == chosen else COMMANDS
    asking: dict[str, _Parser] = {}
    for name in named:
        summary = COMMANDS[name]
        command = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if name == chosen:
            _start_no_threads(name)
            module = _imported(f"planrunner.cli.{name.replace('-', '_')}")
            module.add_arguments(command)
            command.add_argument(
                "--no-excerpt", action="store_true", help="print findings without the source lines that they refer to"
            )
            command.set_defaults(run=module.run)
        asking[name] = command
    parser.set_defaults(json=False)
    parsed, rest = parser.parse_known_args(arguments)
    if rest:  # the parser that knows the command's arguments shows them
        asking.get(parsed.command, parser).error(f"unrecognized arguments: {' '.join(rest)}")
    asked.json = parsed.json
    from planrunner.cli.printing import EXCERPTS

    EXCERPTS.set(not parsed.no_excerpt)
    code: int = parsed.run(parsed)
    return code
