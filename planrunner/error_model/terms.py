"""Terms of an inertial sensor's error model: named functions of the stimulus, and models that are sums of such terms.

A linear term gives one column of a design matrix. An estimator determines the coefficient of a term from the recorded stimulus;
before a run, the check uses the planned stimulus to predict the observability and the uncertainty of the coefficient. (The virtual
gyro uses none of this code: it has separate formulas for the balance of its rotor, so that an error in a formula cannot affect both
simulator and estimators.) Terms are found through the entry-point group `planrunner.terms`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Protocol

import numpy as np

from planrunner.base import plugins
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept
from planrunner.base.said import Said, said
from planrunner.physics.earth import EARTH_RATE, Site
from planrunner.physics.stimulus import Poses, Stimulus, StimulusError
from planrunner.plan.kinds import Choice
from planrunner.plan.units import STANDARD_GRAVITY


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One term of an error model: a coefficient times a function of the stimulus.

    `of`: the function of the stimulus; for a stimulus of n rows it returns the column, shape (n,), SI. `magnitude`: the declared
    size of the column. The column is divided by this size before the rank and the condition of the design matrix are judged.
    `unit`: unit of the column. `degree`: polynomial degree in the components of the stimulus. A term of degree two or more cannot
    be computed from means over a moving attitude, because the mean of a product is not the product of means. `of_motion`: True if
    the column depends on angular rate and specific force alone; the column is then the same for all temperatures and times with the
    same orientations.
    """

    name: str
    description: Said
    magnitude: float
    unit: str
    of: Callable[[Stimulus], Array] = field(repr=False)
    degree: int = 1
    of_motion: bool = False

    def column(self, stimulus: Stimulus) -> Array:
        """Returns the column of the term, shape (n,). Raises `StimulusError` for a term of degree two or more if the attitude
        moves."""
        if self.degree > 1 and bool(stimulus.moving.any()):
            raise StimulusError(
                f"the term {self.name} is a product and cannot be computed from means over turning segments"
            )
        return np.asarray(self.of(stimulus), dtype=float)


def _rate(axis: int) -> Callable[[Stimulus], Array]:
    return lambda stimulus: stimulus.omega[:, axis]


def _accel(axis: int) -> Callable[[Stimulus], Array]:
    return lambda stimulus: stimulus.specific_force[:, axis]


def _product(first: int, second: int) -> Callable[[Stimulus], Array]:
    return lambda stimulus: stimulus.specific_force[:, first] * stimulus.specific_force[:, second]


def _about(axis: str) -> Said:
    return said("Angular rate about the sensor's {axis} axis.", axis=axis)


def _force(axis: str) -> Said:
    return said("Specific force along the sensor's {axis} axis.", axis=axis)


def _along(first: str, second: str) -> Said:
    return said("Product of the specific forces along {first} and {second}.", first=first, second=second)


_G2 = STANDARD_GRAVITY**2
BIAS = Term("bias", said("Constant output."), 1.0, "1", lambda stimulus: np.ones(len(stimulus)), 0, True)
RATE_X = Term("rate_x", _about("x"), EARTH_RATE, "rad/s", _rate(0), of_motion=True)
RATE_Y = Term("rate_y", _about("y"), EARTH_RATE, "rad/s", _rate(1), of_motion=True)
RATE_Z = Term("rate_z", _about("z"), EARTH_RATE, "rad/s", _rate(2), of_motion=True)
ACCEL_X = Term("accel_x", _force("x"), STANDARD_GRAVITY, "m/s^2", _accel(0), of_motion=True)
ACCEL_Y = Term("accel_y", _force("y"), STANDARD_GRAVITY, "m/s^2", _accel(1), of_motion=True)
ACCEL_Z = Term("accel_z", _force("z"), STANDARD_GRAVITY, "m/s^2", _accel(2), of_motion=True)
ACCEL_X_ACCEL_Z = Term("accel_x_accel_z", _along("x", "z"), _G2, "(m/s^2)^2", _product(0, 2), 2, True)
ACCEL_Y_ACCEL_Z = Term("accel_y_accel_z", _along("y", "z"), _G2, "(m/s^2)^2", _product(1, 2), 2, True)


def design_matrix(terms: Sequence[Term], stimulus: Stimulus) -> Array:
    """Returns the design matrix, shape (n, p), SI, with one column per term. Raises `StimulusError` if a term is not defined for
    the stimulus."""
    matrix = np.empty((len(stimulus), len(terms)))
    for k, term in enumerate(terms):
        matrix[:, k] = term.column(stimulus)
    return matrix


class LinearModel(Protocol):
    """A model of outputs that is linear in its coefficients. `of_motion`: True if all columns depend on angular rate and specific
    force alone."""

    @property
    def of_motion(self) -> bool: ...

    def columns(self, stimulus: Stimulus) -> Array:
        """Returns the design matrix in SI units, shape (n, p)."""


def columns_of(model: LinearModel, poses: Poses, site: Site) -> Array:
    """Returns the design matrix of segments, shape (n, p), SI. Raises `StimulusError` if a column cannot be computed for these
    segments."""
    if model.of_motion:
        return _columns_of_motion(model, poses.timeless.arrays, site)
    return model.columns(poses.felt(site))


@kept(256)
def _columns_of_motion(model: LinearModel, poses: tuple[Array, ...], site: Site) -> Array:
    return model.columns(Poses(*poses).felt(site))


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """The error model of one output, as a list of terms."""

    terms: tuple[Term, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(term.name for term in self.terms)

    @property
    def magnitudes(self) -> Array:
        """Returns the declared sizes of the columns, shape (p,), SI."""
        return np.array([term.magnitude for term in self.terms])

    @property
    def of_motion(self) -> bool:
        return all(term.of_motion for term in self.terms)

    def columns(self, stimulus: Stimulus) -> Array:
        """Returns the design matrix, shape (n, p), SI."""
        return design_matrix(self.terms, stimulus)

    def predict(self, coefficients: Mapping[str, float] | Array, stimulus: Stimulus) -> Array:
        """Returns the output, shape (n,), for given coefficients. The coefficients are an array of shape (p,), or a mapping from
        names to values, in which coefficients that are not named are zero. Raises KeyError for the name of a term that the model
        does not have."""
        if isinstance(coefficients, Mapping):
            unknown = set(coefficients) - set(self.names)
            if unknown:
                raise KeyError(", ".join(sorted(unknown)))
            coefficients = np.array([coefficients.get(name, 0.0) for name in self.names])
        return self.columns(stimulus) @ coefficients


def term_names() -> Choice:
    """Returns the type of a plan key whose value is the name of an installed term."""
    return Choice(plugins.names(plugins.TERMS))


def error_model(names: Sequence[str]) -> ErrorModel:
    """Makes the error model that consists of the named terms. Raises `InputError` for a term that is not installed or cannot be
    loaded."""
    terms: list[Term] = [plugins.load(plugins.TERMS, name) for name in dict.fromkeys(names)]
    return ErrorModel(tuple(terms))
