"""Describes inputs other than the recorded data: quantities that are stated with an uncertainty, and the sensitivities of
coefficients to them.

Such quantities are the type B inputs of JCGM 100:2008, 4.3. A bench file, a plan or an estimator states them. An estimator gives
the sensitivity of its coefficients. `planrunner.uncertainty.budget` combines the contributions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass


class Aspect(StrEnum):
    """Names a property of an output that is stated with an uncertainty, such as its resolution. Each output of a sensor has a
    separate input quantity for each property."""

    BIAS_INSTABILITY = "bias instability"
    RESOLUTION = "resolution"

    def of(self, output: str) -> str:
        """Returns the name of the input quantity for an output."""
        return f"{self.value} {output}"


@dataclass(frozen=True, slots=True)
class InputQuantity:
    """One quantity that is stated with an uncertainty.

    `value`, `standard_uncertainty`: value and standard uncertainty in `unit`, which is SI-coherent. `distribution`: normal,
    rectangular, triangular, u-shaped, t. `source`: origin of the stated value, for an auditor: instrument, asset number,
    certificate, or the key of a file. `calibrated`: ISO date of the calibration, or empty. `shown`: unit in which budgets show the
    quantity, usually the unit in which it was stated. One unit `shown` is `shown_factor` times one `unit`. If `shown` is empty,
    budgets use `unit`. `from_residuals`: True if the uncertainty was estimated from the residuals of the same fit, so that it
    depends on the scatter of the data.
    """

    name: str
    value: float
    unit: str
    standard_uncertainty: float
    degrees_of_freedom: float = math.inf
    distribution: str = "normal"
    source: str = ""
    calibrated: str = ""
    shown: str = ""
    shown_factor: float = 1.0
    from_residuals: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """Describes how m coefficients depend on an input quantity.

    `sensitivities`: array of shape (m, r), ∂coefficient/∂input in the unit of the coefficient per `quantity.unit`. There are r
    columns for r independent inputs with the same uncertainty, such as the errors of the table at r positions, and one column if
    all segments share one input. `in_scatter`: True if the scatter of the data already contains the effect of the input. Budgets
    then list the input, but do not add its contribution. `parts`: names of the r inputs, such as orientations. If inputs of two
    influences have the same name, they are the same input. Inputs without names are different inputs.
    """

    quantity: InputQuantity
    sensitivities: Array
    in_scatter: bool = False
    parts: tuple[str, ...] = ()

    @property
    def covariance(self) -> Array:
        """Returns the contribution to the covariance of the coefficients, shape (m, m)."""
        return self.quantity.standard_uncertainty**2 * (self.sensitivities @ self.sensitivities.T)

    def through(self, gradient: Array) -> Influence:
        """Returns the influence on q quantities that are computed from the m coefficients. `gradient`: array of shape (q, m),
        ∂quantity/∂coefficient."""
        return Influence(self.quantity, gradient @ self.sensitivities, self.in_scatter, self.parts)


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One row of a budget (JCGM 100:2008, H.1, table H.1).

    `sensitivity`: sensitivity coefficient c, in the unit of the coefficient per unit of the input. `contribution`: |c|·u, in the
    unit of the coefficient. `kind`: A or B. `added`: True if the row is included in the sum. `count`: number of independent inputs
    with this uncertainty; if there are several, `sensitivity` is the root sum of squares of their sensitivities. `calibrated`: ISO
    date of the calibration, or empty.
    """

    quantity: str
    kind: str
    value: float
    unit: str
    standard_uncertainty: float
    distribution: str
    degrees_of_freedom: float
    sensitivity: float
    contribution: float
    source: str = ""
    added: bool = True
    count: int = 1
    calibrated: str = ""


@dataclass(frozen=True, slots=True)
class Budget:
    """The uncertainty budget of one coefficient. The last line of the budget, the combined uncertainty, is the standard uncertainty
    of the coefficient."""

    coefficient: str
    unit: str
    lines: tuple[BudgetLine, ...]
    standard_uncertainty: float
    degrees_of_freedom: float
    coverage_factor: float


@dataclass(frozen=True, slots=True)
class Inputs:
    """Contains the stated quantities by name, such as `latitude`, `gravity`, `azimuth`, `table position`, `table rate`, `table
    orthogonality`, `temperature`, `fixture angle x`, `fixture azimuth x`, `resolution gyro_x` and `bias instability gyro_x` (whose
    uncertainty is the coefficient B itself). A quantity is absent if no uncertainty is stated for it. `without_flicker`: outputs
    for which the bench file states no bias instability, not even zero."""

    quantities: Mapping[str, InputQuantity] = field(default_factory=dict)
    without_flicker: frozenset[str] = frozenset()

    def get(self, name: str) -> InputQuantity | None:
        return self.quantities.get(name)

    def of_output(self, aspect: Aspect, output: str) -> InputQuantity | None:
        return self.quantities.get(aspect.of(output))
