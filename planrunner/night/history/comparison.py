"""Compares several runs side by side: their coefficients, and the E_n number of each run relative to the first run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from planrunner.archive.formats import IntegrityError
from planrunner.archive.remote import source_of_copy
from planrunner.archive.verifying import open_run
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.night.history.agreement import ParticipantAgreement, agreement
from planrunner.night.history.reading import read_run
from planrunner.night.history.rows import CoefficientRow, IndexedRun, RunRow
from planrunner.uncertainty.homogeneity import SIGNIFICANT, Homogeneity, homogeneity

COMPARISON_FORMAT = 1


@dataclass(frozen=True, slots=True)
class ComparedCoefficient:
    """One coefficient in several compared runs. `values`: for each run, the pair (value, standard uncertainty); None if the run
    lacks the coefficient or has it in another unit. `agreement`: E_n of each other run that has the coefficient, relative to the
    first run. `scatter`: scatter of all runs, compared with their uncertainties; None if fewer than two runs have an uncertainty."""

    quantity: str
    unit: str
    values: tuple[tuple[float, float] | None, ...]
    agreement: tuple[ParticipantAgreement, ...]
    scatter: Homogeneity | None = None

    @property
    def largest_en(self) -> float | None:
        found = [abs(one.en) for one in self.agreement if one.en == one.en]
        return max(found, default=None)


@dataclass(frozen=True, slots=True)
class RunComparison:
    """The comparison of several runs. `runs`: the compared runs, the first of which is the reference. `names`: the runs as the user
    named them; for the copy of a remote run, the URL of the remote run."""

    names: tuple[str, ...]
    runs: tuple[RunRow, ...]
    coefficients: tuple[ComparedCoefficient, ...]

    @property
    def scattered(self) -> tuple[ComparedCoefficient, ...]:
        """Returns the coefficients that scatter more from run to run than their uncertainties allow. With m coefficients, each is
        tested at 1/m of the significance level."""
        tested = [(one, one.scatter) for one in self.coefficients if one.scatter is not None]
        return tuple(one for one, test in tested if test.chance * len(tested) < SIGNIFICANT)

    @property
    def differs(self) -> bool:
        """Returns True if |E_n| > 1 for any coefficient."""
        return any(one.largest_en is not None and one.largest_en > 1 for one in self.coefficients)

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/comparison.schema.json."""
        return {
            "planrunner_comparison": COMPARISON_FORMAT,
            "runs": [{**run.to_json(), "folder": name} for name, run in zip(self.names, self.runs, strict=True)],
            "coefficients": [
                {
                    "quantity": one.quantity,
                    "unit": one.unit,
                    "values": [
                        None
                        if found is None
                        else {"value": found[0], "standard_uncertainty": found[1] if found[1] == found[1] else None}
                        for found in one.values
                    ],
                    "largest_en": one.largest_en,
                    "scatter": None if one.scatter is None else one.scatter.to_json(),
                }
                for one in self.coefficients
            ],
        }


def compare_runs(runs: Sequence[Path]) -> RunComparison:
    """Returns the coefficients of several runs side by side. Raises `InputError` for a run that cannot be compared, for example a
    run without an analysis, and `IntegrityError` for a run that was changed."""
    found = [_read(run) for run in runs]
    rows = [one.run for one in found if one.run is not None]
    held = [{row.quantity: row for row in one.coefficients} for one in found]
    quantities = list(dict.fromkeys(name for one in held for name in one))
    compared = tuple(_compared(name, [one.get(name) for one in held]) for name in quantities)
    names = tuple(source_of_copy(run) or str(run) for run in runs)
    return RunComparison(names, tuple(rows), compared)


def _read(run: Path) -> IndexedRun:
    open_run(run)
    found = read_run(run, ".")
    if found.fault:
        raise IntegrityError(found.fault)
    if found.run is not None and not found.run.analysis:
        hint = "make an analysis with `planrunner estimate`"
        raise InputError.at(Mark(str(run)), "analysis-missing", "this run has no analysis yet", hint)
    return found


def _compared(quantity: str, rows: Sequence[CoefficientRow | None]) -> ComparedCoefficient:
    unit = next(row.unit for row in rows if row is not None)
    values = tuple(
        (row.value, row.standard_uncertainty)
        if row is not None and row.unit == unit and row.value == row.value
        else None
        for row in rows
    )
    places = {str(place): [one] for place, one in enumerate(values) if one is not None and one[1] == one[1]}
    known = [row for row, one in zip(rows, values, strict=True) if row is not None and one is not None]
    scatter = homogeneity(
        [row.value for row in known],
        [row.standard_uncertainty for row in known],
        [row.degrees_of_freedom for row in known],
        known[0].period if known else math.inf,
    )
    return ComparedCoefficient(quantity, unit, values, agreement(places, "0") if "0" in places else (), scatter)
