"""Inputs other than the data: quantities stated with an uncertainty, and the sensitivity of coefficients to them.

These are the type B inputs of JCGM 100:2008, 4.3. A bench file, a plan or an estimator states them. An estimator gives the sensitivity of
its coefficients. `planrunner.uncertainty.budget` combines the contributions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass


class Aspect(StrEnum):
    """A kind of quantity that is stated for each output of a sensor; every output has its own input quantity."""

    BIAS_INSTABILITY = "bias instability"
    RESOLUTION = "resolution"

    def of(self, output: str) -> str:
        """The name of the input quantity."""
        return f"{self.value} {output}"


@dataclass(frozen=True, slots=True)
class InputQuantity:
    """One stated quantity. value, standard_uncertainty: in `unit`, SI-coherent. distribution: normal, rectangular, triangular,
    u-shaped, t. source: origin of the statement, for an auditor: instrument, asset number, certificate, or the key of a file.
    calibrated: ISO date, or empty. shown: unit in budgets, usually the unit of the statement, equal to `shown_factor` times `unit`;
    if empty, budgets show `unit`. from_residuals: True if the uncertainty was estimated from the residuals of the same fit, so that
    it is not independent of the scatter of the data.
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
    """Dependence of m coefficients on an input quantity.

    sensitivities: (m, r), ∂coefficient/∂input in the coefficient's unit per `quantity.unit`. r > 1 for r independent inputs with
    the same uncertainty, such as the error of the table at each of r positions; r = 1 for an input that all segments share.
    in_scatter: True if the scatter of the data already contains the input; the budget then lists the input without adding it.
    parts: names of the r inputs, such as orientations, which identify an input that acts through two influences; inputs without
    names count as different.
    """

    quantity: InputQuantity
    sensitivities: Array
    in_scatter: bool = False
    parts: tuple[str, ...] = ()

    @property
    def covariance(self) -> Array:
        """Contribution to the covariance of the coefficients, shape (m, m)."""
        return self.quantity.standard_uncertainty**2 * (self.sensitivities @ self.sensitivities.T)

    def through(self, gradient: Array) -> Influence:
        """The influence on q quantities computed from the m coefficients. gradient: shape (q, m), ∂quantity/∂coefficient."""
        return Influence(self.quantity, gradient @ self.sensitivities, self.in_scatter, self.parts)


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One row of a budget (JCGM 100:2008, H.1, table H.1). sensitivity: c, in the coefficient's unit per unit of the input;
    contribution: |c|·u, in the coefficient's unit. kind: A or B; added: True if the row is part of the sum. count: number of
    independent inputs with this uncertainty; for several, the sensitivity is the root sum of squares. calibrated: ISO date, or
    empty."""

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
    """The uncertainty budget of one coefficient. The combined uncertainty is the standard uncertainty of the coefficient."""

    coefficient: str
    unit: str
    lines: tuple[BudgetLine, ...]
    standard_uncertainty: float
    degrees_of_freedom: float
    coverage_factor: float


@dataclass(frozen=True, slots=True)
class Inputs:
    """Stated quantities by name, such as `latitude`, `gravity`, `azimuth`, `table position`, `table rate`, `table orthogonality`,
    `temperature`, `fixture angle x`, `fixture azimuth x`, `resolution gyro_x`, `bias instability gyro_x` (whose uncertainty is the
    coefficient B itself). A quantity is absent if no uncertainty was stated. without_flicker: outputs for which the bench file gives no
    bias instability, not even zero."""

    quantities: Mapping[str, InputQuantity] = field(default_factory=dict)
    without_flicker: frozenset[str] = frozenset()

    def get(self, name: str) -> InputQuantity | None:
        return self.quantities.get(name)

    def of_output(self, aspect: Aspect, output: str) -> InputQuantity | None:
        return self.quantities.get(aspect.of(output))
