"""Computes the influences of stated inputs on the results of a formula. A method declares these inputs as the conditions of its
formula. The influences are then computed by evaluating this formula.

A result must be a pure function of observations and conditions. Each input with a stated uncertainty is a `StatedCondition`. A
`StatedCondition` contains the input quantity and functions that change the conditions. The formula is evaluated twice: with the
input increased, and with the input decreased by its standard uncertainty. Half of the difference between the two results is the
contribution of the input (JCGM 100:2008, 5.1.3, note 2). The step is the standard uncertainty, so rounding errors of the formula
remain small for every unit and size of the input.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.uncertainty.derivatives import central
from planrunner.uncertainty.influences import Influence, InputQuantity

C = TypeVar("C")
D = TypeVar("D")

Moved = Callable[[float], C]
"""Function that returns the conditions after one input has been increased by the given amount, in the unit of the input."""


@dataclass(frozen=True, slots=True)
class StatedCondition(Generic[C]):
    """An input of a formula that is stated with an uncertainty above zero. `parts`: maps the name of each independent part of the
    input to a function that returns the conditions after a change of this part. If there is only one part, its name is empty.
    `in_scatter`: True if the scatter of the data already contains the effect of the input."""

    quantity: InputQuantity
    parts: Mapping[str, Moved[C]]
    in_scatter: bool = False

    @classmethod
    def single(cls, quantity: InputQuantity, moved: Moved[C]) -> StatedCondition[C]:
        """Makes a condition that has a single part."""
        return cls(quantity, {"": moved})

    @property
    def names(self) -> tuple[str, ...]:
        """Returns the names of the parts, in the form that `Influence` requires."""
        return () if tuple(self.parts) == ("",) else tuple(self.parts)

    def seen_by(self, view: Callable[[C], D]) -> StatedCondition[D]:
        """Returns the same input, as a condition of another formula. `view`: function that converts the conditions of this formula
        to the conditions of the other formula."""
        parts = {name: _after(moved, view) for name, moved in self.parts.items()}
        return StatedCondition(self.quantity, parts, self.in_scatter)

    def answers(self, formula: Callable[[C], Array]) -> list[Array]:
        """Returns, for each part of the input, the derivative of the formula's results with respect to this part. The derivative
        has the shape of the results."""
        return slopes(formula, self.parts.values(), self.quantity.standard_uncertainty)


def influences_on(formula: Callable[[C], Array], stated: Iterable[StatedCondition[C]]) -> tuple[Influence, ...]:
    """Returns the influences of stated inputs on the m results of a formula."""
    return influences_on_several(lambda each: np.stack([formula(one) for one in each]), stated)


def influences_on_several(
    formula: Callable[[Sequence[C]], Array], stated: Iterable[StatedCondition[C]]
) -> tuple[Influence, ...]:
    """Computes the influences of stated inputs on the m results of a formula. The formula is evaluated for k conditions in one call
    and returns an array of shape (k, m)."""
    inputs = [one for one in stated if one.parts]
    moved: list[C] = []
    for one in inputs:
        u = one.quantity.standard_uncertainty
        moved += [part(by) for part in one.parts.values() for by in (u, -u)]
    if not moved:
        return ()
    results = formula(moved)
    changes, found, begin = (results[0::2] - results[1::2]).T, [], 0
    for one in inputs:
        end = begin + len(one.parts)
        answers = changes[:, begin:end] / (2 * one.quantity.standard_uncertainty)
        found.append(Influence(one.quantity, answers, one.in_scatter, one.names))
        begin = end
    return tuple(found)


def slopes(formula: Callable[[C], Array], moved: Iterable[Moved[C]], step: float) -> list[Array]:
    """Returns the derivative of a formula's results with respect to each change of its conditions. A derivative has the shape of
    the results. For each change, the formula is evaluated twice: with a change by +`step` and with a change by −`step`."""
    return [central(_after(one, formula), step) for one in moved]


def _after(moved: Moved[C], view: Callable[[C], D]) -> Moved[D]:
    return lambda by: view(moved(by))
