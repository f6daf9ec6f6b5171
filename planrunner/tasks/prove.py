"""Recomputes the results of a stored analysis from the samples, and compares them with the stored results bit by bit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from planrunner.archive.analyses import chosen_analysis
from planrunner.archive.formats import from_bytes, to_bytes
from planrunner.archive.provenance import computed_with
from planrunner.archive.run_reader import RunReader
from planrunner.base.documents import Json, JsonObject
from planrunner.base.workers import ALONE, Workers
from planrunner.estimators.results import Results, comparable, differences
from planrunner.tasks.estimate import computed_by, recompute, stored_results

Reproduced = Literal["identical", "within tolerance", "different"]

TOLERANCE = 1e-3
"""Largest accepted change of a coefficient that other software versions computed, as a fraction of its standard uncertainty.
Results are shown to two digits of the uncertainty, so such a change is about a hundredth of the last digit."""


@dataclass(frozen=True, slots=True)
class Proof:
    """Compares recomputed results with the stored results of an analysis.

    `verdict`: `identical` if all bits of every number are equal. The verdict `within tolerance` is possible only if the stored
    results were computed by other versions. `largest`: the largest change of a value or of a standard uncertainty, with the name
    of the coefficient. The change is in units of the stored standard uncertainty; it is ∞ if the coefficient is missing from the
    recomputed results. `changed`: the versions that differ, each as a pair (stored, now). `stored` is None if the analysis does
    not state the version. `places`: the places in the results that differ. `only_texts`: True if only texts differ there, such as
    notes and warnings, and every number is identical.
    """

    analysis: int
    verdict: Reproduced
    largest: float
    largest_of: str
    changed: Mapping[str, tuple[str | None, str | None]]
    places: tuple[str, ...] = ()
    only_texts: bool = False

    def to_json(self) -> JsonObject:
        return {
            "analysis": self.analysis,
            "verdict": self.verdict,
            "largest_change": self.largest if math.isfinite(self.largest) else None,
            "largest_change_of": self.largest_of,
            "tolerance": TOLERANCE,
            "places_changed": list(self.places),
            "only_texts_changed": self.only_texts,
            "versions_changed": {name: list(pair) for name, pair in self.changed.items()},
        }


def prove(run: Path, number: int | None = None, workers: Workers = ALONE) -> Proof:
    """Recomputes an analysis of a run with the settings of the analysis, and writes nothing. `number`: number of the analysis; by
    default, the newest. `workers`: processes that share the Monte Carlo draws.

    Raises `InputError` if the run does not have this analysis, and `IntegrityError` if a file of the run was changed.
    """
    reader = RunReader.open(run)
    analysis = chosen_analysis(run, reader.analyses, number)
    stored, text, then = stored_results(analysis), *computed_by(analysis)
    results = recompute(reader, analysis, workers=workers)
    now = computed_with()
    changed = {name: (then.get(name), now.get(name)) for name in {**then, **now} if then.get(name) != now.get(name)}
    again = results.to_json()
    if to_bytes(comparable(text)) == to_bytes(comparable(again)):
        return Proof(analysis.number, "identical", 0.0, "", changed)
    largest, name = max(_changes(stored, results), default=(math.inf, ""))
    same_rest = _outline(stored) == _outline(results)
    tolerated = bool(changed) and same_rest and largest <= TOLERANCE
    verdict: Reproduced = "within tolerance" if tolerated else "different"
    differing = tuple(differences(text, from_bytes(to_bytes(again))))
    only_texts = bool(differing) and all(of_text for _, of_text in differing)
    places = tuple(place for place, _ in differing)
    return Proof(analysis.number, verdict, largest, name, changed, places, only_texts)


def _changes(stored: Results, now: Results) -> Iterator[tuple[float, str]]:
    """Yields the change and the name of each coefficient. The change is the larger of two changes, in units of the stored standard
    uncertainty: the change of the value, and the change of the standard uncertainty."""
    for name, estimate in stored.estimates.items():
        again = {} if name not in now.estimates else {one.name: one for one in now.estimates[name].coefficients}
        for one in estimate.coefficients:
            other = again.get(one.name)
            yield (
                math.inf
                if other is None
                else max(
                    _change(one.value, other.value, one.standard_uncertainty),
                    _change(one.standard_uncertainty, other.standard_uncertainty, one.standard_uncertainty),
                ),
                f"{name}.{one.name}",
            )


def _change(stored: float, now: float, uncertainty: float) -> float:
    if stored == now or (math.isnan(stored) and math.isnan(now)):
        return 0.0
    size = abs(now - stored) / uncertainty if uncertainty > 0 else math.inf
    return size if math.isfinite(size) else math.inf


def _outline(results: Results) -> Json:
    """Returns the names and verdicts in the results. In the stored and the recomputed results, names and verdicts must be equal
    even if the last digits of numbers differ."""
    return [
        [[name, [one.name for one in item.coefficients]] for name, item in results.estimates.items()],
        [[limit.quantity, limit.verdict] for limit in results.limits],
        sorted(results.failures),
    ]
