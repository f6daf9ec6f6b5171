"""Validates this installation: the whole program evaluates, on the user's computer, reference recordings whose results are known.

Each reference plan in `plans/self_test` is checked, played back, recorded, estimated and compared with `answers.yaml`. Then one
byte of a recorded file is changed, and the program must detect it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_reader import RunReader
from planrunner.base.documents import JsonObject
from planrunner.base.shipped import shipped
from planrunner.estimators.results import Results
from planrunner.execution.stopping import StopRequest
from planrunner.plan import source
from planrunner.tasks.check import check_plan
from planrunner.tasks.estimate import analyse_run
from planrunner.tasks.run import start


@dataclass(frozen=True, slots=True)
class Comparison:
    """Contains a known answer and the value that this installation computes. `difference`: absolute value of the relative
    difference."""

    case: str
    quantity: str
    known: str
    found: str
    difference: float
    allowed: float

    @property
    def passed(self) -> bool:
        return self.difference <= self.allowed


def validate(folder: Path) -> Iterator[Comparison]:
    """Runs every reference plan in `folder`, which must be empty; yields each comparison with a known answer as soon as it is made."""
    references = shipped("plans") / "self_test"
    answers: JsonObject = source.plain(source.load(references / "answers.yaml"))
    run = folder
    for case, answer in answers.items():
        run, results = _carry_out(references / f"{case}.yaml", references, folder)
        for quantity, known in answer["coefficients"].items():
            yield from _compare(case, quantity, known, results, float(answer["relative"]))
    yield _tamper(run)


def _carry_out(plan: Path, data: Path, folder: Path) -> tuple[Path, Results]:
    run, outcome = start(check_plan(plan).sound(), info={}, runs=folder, stop=StopRequest(), data_root=data)
    if not outcome.ok:
        raise RuntimeError(f"{plan.name} did not run: {'; '.join(map(str, outcome.failures))}")
    return run, analyse_run(run).results


def _compare(
    case: str, quantity: str, known: dict[str, float], results: Results, allowed: float
) -> Iterator[Comparison]:
    estimate, _, name = quantity.partition(".")
    coefficient = results.estimates[estimate][name]
    for key, found, shown in (
        ("value", coefficient.value, quantity),
        ("standard_uncertainty", coefficient.standard_uncertainty, f"u({quantity})"),
    ):
        if key in known:
            expected = float(known[key])
            yield Comparison(case, shown, f"{expected:.15g}", f"{found:.15g}", abs(found / expected - 1), allowed)


def _tamper(run: Path) -> Comparison:
    """Changes a byte in a recorded file; returns a comparison that shows whether the program detects the change."""
    file = sorted((run / "segments").glob("*.parquet"))[0]
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(bytes(data))
    try:
        RunReader.open(run).check_digests()
        noticed = "not noticed"
    except IntegrityError:
        noticed = "noticed"
    return Comparison("integrity", "one changed bit", "noticed", noticed, float(noticed != "noticed"), 0.0)
