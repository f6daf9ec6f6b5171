"""Computes the agreement between benches or laboratories as E_n numbers.

    E_n = (x − X) / √(U(x)² + U(X)²)

with expanded uncertainties U for about 95 %. |E_n| ≤ 1 means agreement (ISO 13528:2022, 9.7; ISO/IEC 17043:2023, B.3.1.3). x is the
mean of the values of one participant. The standard uncertainty of x is the root mean square of the stated standard uncertainties.
This uncertainty does not decrease with the number of runs, because most errors that the uncertainty of a bench covers are the same
in all runs on this bench. The reference X is the value of a named participant. If no participant is named, X is the mean of all
other participants, weighted with 1/u². The examined participant is excluded from this mean, because the formula requires
independent values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from planrunner.base.dataclass import dataclass

COVERAGE = 2.0


@dataclass(frozen=True, slots=True)
class ParticipantAgreement:
    """The agreement of one participant with the reference.

    `value`, `standard_uncertainty`: mean of the participant's values and standard uncertainty of this mean. `reference`,
    `reference_uncertainty`: reference value and its standard uncertainty. `runs`: number of the participant's values.
    """

    name: str
    runs: int
    value: float
    standard_uncertainty: float
    reference: float
    reference_uncertainty: float

    @property
    def en(self) -> float:
        """Returns the E_n number; nan if neither the value nor the reference has an uncertainty."""
        expanded = COVERAGE * math.hypot(self.standard_uncertainty, self.reference_uncertainty)
        return (self.value - self.reference) / expanded if expanded > 0 else math.nan

    @property
    def agrees(self) -> bool:
        return abs(self.en) <= 1


def agreement(
    values: Mapping[str, Sequence[tuple[float, float]]], reference: str | None = None
) -> tuple[ParticipantAgreement, ...]:
    """Returns the E_n number of every participant, by name. `values`: maps each participant to its values with their standard
    uncertainties. `reference`: the participant whose value serves as the reference value. The result is empty if there are fewer
    than two participants."""
    means = {name: _mean(found) for name, found in values.items() if found}
    compared = []
    for name, (value, u) in sorted(means.items()):
        others = {other: mean for other, mean in means.items() if other != name and reference in (None, other)}
        if not others:
            continue
        compared.append(ParticipantAgreement(name, len(values[name]), value, u, *_weighted(list(others.values()))))
    return tuple(compared)


def _mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    n = len(values)
    return math.fsum(x for x, _ in values) / n, math.sqrt(math.fsum(u**2 for _, u in values) / n)


def _weighted(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    if any(u == 0 for _, u in values):  # those are exact; the others do not count beside them
        values = [(x, u) for x, u in values if u == 0]
        return math.fsum(x for x, _ in values) / len(values), 0.0
    weights = [1 / u**2 for _, u in values]
    mean = math.fsum(w * x for w, (x, _) in zip(weights, values, strict=True)) / math.fsum(weights)
    return mean, math.sqrt(1 / math.fsum(weights))
