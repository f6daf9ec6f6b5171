"""A plan checked and, where it passes, run in this process as `planrunner run` would: what `check` said and how the run ended."""

from __future__ import annotations

import json
import shutil
import traceback
import zlib
from dataclasses import dataclass
from pathlib import Path

from planrunner.base.findings import InputError
from planrunner.cli.outcome import code_of
from planrunner.execution.stopping import StopRequest
from planrunner.tasks import run as running
from planrunner.tasks.check import Sound, check_plan
from planrunner.tasks.estimate import analyse_run

from .written_plans import Plan


@dataclass(frozen=True)
class Ended:
    """passed: whether `check` found no error; errors, warnings: the codes that it found; code: the exit code of `run`, None where it was
    not run; told: what `run` said of what failed; unfit: whether it said that the data do not give an estimate."""

    passed: bool
    errors: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    code: int | None = None
    told: str = ""
    unfit: bool = False

    @property
    def agrees(self) -> bool:
        """Whether the run ended as `check` let expect, or for a reason that only its data show."""
        return not self.passed or self.code in (0, 1)


def written(plan: Plan) -> str:
    """The text of its file: YAML is a superset of JSON."""
    return json.dumps(plan, indent=1, ensure_ascii=False)


def carried_out(path: Path, runs: Path) -> Ended:
    """Check the plan at `path` and run it beneath `runs`, whose run folder is removed again."""
    checked = check_plan(path)
    errors = tuple(sorted({finding.code for finding in checked.findings.errors}))
    if not checked.ok:
        assert errors, "refused without an error"
        return Ended(False, errors)
    warnings = tuple(sorted({finding.code for finding in checked.findings if finding.severity == "warning"}))
    try:
        return Ended(True, errors, warnings, *_run(checked.sound(), runs))
    except Exception:  # a traceback is what must not be
        return Ended(True, errors, warnings, None, traceback.format_exc())
    finally:
        shutil.rmtree(runs, ignore_errors=True)


def _run(sound: Sound, runs: Path) -> tuple[int, str, bool]:
    try:
        drawn = zlib.crc32(sound.plan_bytes)  # the same noise each time, so that a plan that fails can be run again
        folder, outcome = running.start(sound, info={}, runs=runs, stop=StopRequest(), durability="flushed", seed=drawn)
    except InputError as error:
        return 2, str(error), False
    if not outcome.ok:
        return 3, "; ".join(map(str, outcome.failures)) or "; ".join(outcome.unsafe), False
    results = analyse_run(folder).results
    told = "; ".join(f"{name}: {text}" for name, text in results.failures.items())
    return code_of(results), told, bool(results.unfit)
