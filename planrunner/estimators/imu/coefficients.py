"""What an IMU's calibration reports, from the fitted responses of its triads: names, values, units and gradients.

    measured = S·M·true + b + G·f

S is diagonal (scale factors), the rows of M have length one (misalignments), b is the bias; G, of gyros, the response to specific force f.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.error_model.terms import ErrorModel
from planrunner.estimators.interface import EstimationError, UnfitDataError
from planrunner.estimators.triad import own_frame, scale_and_misalignments, turned_gradient
from planrunner.plan.units import DIMENSIONS, Unit, UnknownUnitError, unit

Array = NDArray[np.float64]

AXES = ("x", "y", "z")
PLURAL = {"gyro": "gyros", "accel": "accelerometers"}
_SENSED = {"gyro": "rate", "accel": "accel"}
_PER = {"gyro": "deg/s", "accel": "g"}
_BIAS = {"gyro": "deg/h", "accel": "mg"}
_COLUMNS = {"rad/s": "(deg/s)", "m/s^2": "g", "(m/s^2)^2": "g^2"}
_DIMENSION = {"gyro": DIMENSIONS["angular rate"], "accel": DIMENSIONS["acceleration"]}


@dataclass(frozen=True, slots=True)
class Response:
    """How three outputs respond. kind: gyro or accel. units: (3,) that they are recorded in. values: (3, p), coefficients of the model's
    terms in those units per SI column."""

    kind: str
    units: tuple[Unit, ...]
    model: ErrorModel
    values: Array

    def places(self, quantity: str) -> dict[int, int]:
        """Direction → place among the terms, of the quantity `rate` or `accel`."""
        names = self.model.names
        return {k: names.index(f"{quantity}_{axis}") for k, axis in enumerate(AXES) if f"{quantity}_{axis}" in names}

    @property
    def sensed(self) -> dict[int, int]:
        return self.places(_SENSED[self.kind])


@dataclass(frozen=True, slots=True)
class Reported:
    """q quantities. gradients: (q, r), d(value in its unit)/d(response), over the responses of all triads one after the other."""

    names: tuple[str, ...]
    values: Array
    units: tuple[str, ...]
    gradients: Array
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Framed:
    """The responses in the frame that they are reported in. gradient: (r, r), d(here)/d(as fitted). reference: the kind of the triad whose
    own frame it is, empty for the fixture's. angles, angle_gradient: (3,) rad and (3, r), of the turn from the fixture's frame."""

    responses: tuple[Response, ...]
    gradient: Array
    reference: str = ""
    angles: Array | None = None
    angle_gradient: Array | None = None


def framed(responses: Sequence[Response], lower_triangular: bool) -> Framed:
    """The responses as fitted, or in the own frame of the accelerometers, of the gyros where there are none. Raises `EstimationError`."""
    size = sum(one.values.size for one in responses)
    if not lower_triangular:
        return Framed(tuple(responses), np.eye(size))
    reference = responses[-1]  # the accelerometers, if there are any
    starts = np.cumsum([0, *(one.values.size for one in responses)])
    _must_turn(responses)
    columns = [reference.sensed[k] for k in range(3)]
    matrix = reference.values[:, columns] * np.array([[own.factor] for own in reference.units])
    try:
        own = own_frame(matrix)
    except ValueError as error:
        raise EstimationError(f"no frame can be defined by the {reference.kind} outputs: {error}") from None
    angle_gradient = np.zeros((3, size))
    p = reference.values.shape[1]
    for i in range(3):
        for k in range(3):
            column = starts[-2] + i * p + columns[k]
            angle_gradient[:, column] = own.angle_gradient[:, 3 * i + k] * reference.units[i].factor
    gradient, found = np.eye(size), []
    for start, one in zip(starts, responses, strict=False):
        values, p = one.values.copy(), one.values.shape[1]
        for places in (one.places("rate"), one.places("accel")):
            if places:
                listed = [places[k] for k in range(3)]
                rows = [start + i * p + place for i in range(3) for place in listed]
                by_matrix, by_angles = turned_gradient(one.values[:, listed], own)
                gradient[rows] = 0.0
                gradient[np.ix_(rows, rows)] = by_matrix
                gradient[rows] += by_angles @ angle_gradient
                values[:, listed] = one.values[:, listed] @ own.rotation.T
        found.append(Response(one.kind, one.units, one.model, values))
    return Framed(tuple(found), gradient, reference.kind, own.angles, angle_gradient)


def _must_turn(responses: Sequence[Response]) -> None:
    """Raises `EstimationError` where a model has terms whose meaning in another frame is not known."""
    for one in responses:
        rates, forces = one.places("rate"), one.places("accel")
        known = {"bias", *(f"{name}_{axis}" for name in ("rate", "accel") for axis in AXES)}
        others = [name for name in one.model.names if name not in known]
        if others:
            raise EstimationError(
                f"the term {others[0]} cannot be turned into another frame: write `misalignment: full`"
            )
        if len(one.sensed) < 3 or any(len(places) not in (0, 3) for places in (rates, forces)):
            raise EstimationError(
                "a lower triangular matrix needs all three axes of each term: write `misalignment: full`"
            )


def reported(frame: Framed) -> Reported:
    """Everything that is reported. Raises `EstimationError` for an output that does not respond."""
    rows: list[tuple[str, float, str, Array, str]] = []
    start, size = 0, len(frame.gradient)
    for one in frame.responses:
        for axis in range(3):
            p = len(one.model.names)
            for name, value, text, slopes, words in _axis(one, axis, one.kind == frame.reference):
                gradient = np.zeros(size)
                gradient[start + axis * p : start + (axis + 1) * p] = slopes
                rows.append((name, value, text, gradient @ frame.gradient, words))
        start += one.values.size
    if frame.angles is not None and frame.angle_gradient is not None:
        arcmin = unit("arcmin").factor
        for k, axis_name in enumerate(AXES):
            words = f"Rotation of the triad's own frame against the fixture's about {axis_name}"
            turn = float(frame.angles[k] / arcmin), "arcmin", frame.angle_gradient[k] / arcmin
            rows.append((f"rotation_{axis_name}", *turn, words))
    names, values, units, gradients, words_ = zip(*rows, strict=True)
    return Reported(names, np.array(values), units, np.array(gradients), words_)


def _axis(one: Response, axis: int, own_frame_: bool) -> list[tuple[str, float, str, Array, str]]:
    """(name, value, unit, slopes (p,), words) of one output."""
    own, letter, p = one.units[axis], AXES[axis], len(one.model.names)
    direct = own.dimension == _DIMENSION[one.kind]
    plain = _BIAS[one.kind] if direct else f"({own.text})"
    values = one.values[axis]
    found: list[tuple[str, float, str, Array, str]] = []

    def add(name: str, value: float, text: str, slopes: dict[int, float], words: str) -> None:
        """value and slopes in own unit per SI column; text: the unit to report in."""
        try:
            factor = own.factor / unit(text).factor
        except UnknownUnitError as error:
            raise EstimationError(f"the coefficient {one.kind}_{name} has an unknown unit: {error}") from None
        full = np.zeros(p)
        full[list(slopes)] = list(slopes.values())
        found.append((f"{one.kind}_{name}", float(value * factor), text, full * factor, words))

    sensed = one.sensed
    for k, name in enumerate(one.model.names):
        if name == "bias":
            text = _BIAS[one.kind] if direct else own.text
            add(f"bias_{letter}", values[k], text, {k: 1.0}, f"Bias of output {letter}")
    directions, places = list(sensed), list(sensed.values())
    per = "1" if direct else f"({own.text})/({_PER[one.kind]})"
    try:
        derived, jacobian = scale_and_misalignments(values[places], directions, axis)
    except ValueError:
        raise UnfitDataError(
            f"output {letter} of the {PLURAL[one.kind]} does not respond at all: check that it is connected"
        ) from None
    for row, direction in enumerate(directions):
        slopes = dict(zip(places, jacobian[row], strict=True))
        across = f"misalignment_{letter}_{AXES[direction]}"
        if direction == axis:
            add(
                f"scale_{letter}",
                derived[row],
                per,
                slopes,
                f"Scale factor of output {letter}, along its own input axis",
            )
        elif axis not in directions:
            add(across, derived[row], per, slopes, f"Response of output {letter} along {AXES[direction]}")
        elif not (own_frame_ and direction > axis):
            ratio = {k: float(slope) / own.factor for k, slope in slopes.items()}  # the output's unit cancels
            words = f"Component of the input axis {letter} along {AXES[direction]}"
            add(across, derived[row] / own.factor, "mrad", ratio, words)
    across_g = one.places("accel") if one.kind == "gyro" else {}
    for direction, k in across_g.items():
        words = f"Response of output {letter} to specific force along {AXES[direction]}"
        add(f"g_sensitivity_{letter}_{AXES[direction]}", values[k], f"{plain}/g", {k: 1.0}, words)
    for k, term in enumerate(one.model.terms):
        if term.name != "bias" and k not in places and k not in across_g.values():
            column = _COLUMNS.get(term.unit, f"({term.unit})")
            text = plain if term.unit == "1" else f"{plain}/{column}"
            add(f"{term.name}_{letter}", values[k], text, {k: 1.0}, f"Output {letter}: {term.description}")
    return found
