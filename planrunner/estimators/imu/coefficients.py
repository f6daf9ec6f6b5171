"""Computes the results of an IMU calibration from the fitted responses of its triads. Gives the names and units of the results, and
one formula for all of them.

    measured = S·M·true + b + G·f

S is diagonal (scale factors), the rows of M have length one (misalignments), and b is the bias. For gyros, G is the response to
specific force f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.error_model.terms import ErrorModel
from planrunner.estimators.declared_axes import AxisResponse
from planrunner.estimators.derived import Reported
from planrunner.estimators.interface import EstimationError, UnfitDataError
from planrunner.estimators.triad import RowFormula, own_frame, scale_and_misalignments, small_angles
from planrunner.plan.units import DIMENSIONS, Unit, UnknownUnitError, unit
from planrunner.uncertainty.derivatives import Formula

AXES = ("x", "y", "z")
PLURAL = {"gyro": "gyros", "accel": "accelerometers"}
_SENSED = {"gyro": "rate", "accel": "accel"}
_PER = {"gyro": "deg/s", "accel": "g"}
_BIAS = {"gyro": "deg/h", "accel": "mg"}
_COLUMNS = {"rad/s": "(deg/s)", "m/s^2": "g", "(m/s^2)^2": "g^2"}
_DIMENSION = {"gyro": DIMENSIONS["angular rate"], "accel": DIMENSIONS["acceleration"]}


@dataclass(frozen=True, slots=True)
class Response:
    """Contains the responses of the three outputs of a triad.

    `kind`: gyro or accel. `units`: for each of the three outputs, the unit in which it is recorded. `values`: array of shape (3,
    p), for each output, the coefficients of the model's terms, in the unit of the output per SI unit of the term.
    """

    kind: str
    units: tuple[Unit, ...]
    model: ErrorModel
    values: Array

    def places(self, quantity: str) -> dict[int, int]:
        """Maps each axis of the quantity `rate` or `accel` to the index of its term in the model."""
        names = self.model.names
        return {k: names.index(f"{quantity}_{axis}") for k, axis in enumerate(AXES) if f"{quantity}_{axis}" in names}

    @property
    def sensed(self) -> dict[int, int]:
        return self.places(_SENSED[self.kind])

    def rows(self, channels: Sequence[str]) -> list[AxisResponse]:
        """Returns the responses of those outputs that are recorded in a unit of the sensed quantity."""
        return [
            AxisResponse(
                channels[axis],
                axis,
                own,
                {k: float(self.values[axis, place]) * own.factor for k, place in self.sensed.items()},
            )
            for axis, own in enumerate(self.units)
            if own.dimension == _DIMENSION[self.kind]
        ]


@dataclass(frozen=True, slots=True)
class Framed:
    """Contains the responses of all triads, in the frame in which they are reported. `reference`: the kind of the triad that
    defines the frame; empty for the frame of the fixture."""

    responses: tuple[Response, ...]
    reference: str = ""


@dataclass(frozen=True, slots=True)
class ImuResults:
    """Contains all reported quantities, one triad after the other, and the formula that computes them from the fitted responses.
    `frame`: the fitted responses in the reported frame."""

    frame: Framed
    quantities: tuple[Reported, ...]
    formula: Formula


def calibration(fitted: Sequence[Response], lower_triangular: bool) -> ImuResults:
    """Computes the results in the frame of the fixture or, if `lower_triangular` is True, in the accelerometers' own frame (the
    gyros' own frame if there are no accelerometers). Raises `EstimationError` if no frame can be defined or a term cannot be
    transformed. Raises `UnfitDataError` for an output that does not respond."""
    reference = fitted[-1] if lower_triangular else None  # the accelerometers, if there are any
    if lower_triangular:
        _must_turn(fitted)
    rows = [
        (k, axis, part)
        for k, one in enumerate(fitted)
        for axis in range(3)
        for part in _axis(one, axis, one is reference)
    ]
    arcmin = unit("arcmin").factor
    turns = [
        said("Rotation of the triad's own frame relative to the fixture's frame about {axis}", axis=name)
        for name in AXES
        if reference
    ]

    def in_frame(flat: Array) -> tuple[list[Array], Array | None]:
        values = _split(fitted, flat)
        if reference is None:
            return values, None
        rotation = _rotation(reference, values[-1])
        return [_turned(one, own, rotation) for one, own in zip(fitted, values, strict=True)], rotation

    def formula(flat: Array) -> Array:
        values, rotation = in_frame(flat)
        made = np.stack([part.of(values[k][axis]) * part.factor for k, axis, part in rows])
        return made if rotation is None else np.concatenate([made, small_angles(rotation) / arcmin])

    values, _ = in_frame(np.concatenate([one.values.ravel() for one in fitted])[:, None])
    responses = tuple(replace(one, values=own[..., 0]) for one, own in zip(fitted, values, strict=True))
    quantities = (
        *(part.reported for _, _, part in rows),
        *(Reported(f"rotation_{name}", "arcmin", words) for name, words in zip(AXES, turns, strict=False)),
    )
    return ImuResults(Framed(responses, reference.kind if reference else ""), quantities, formula)


def _split(fitted: Sequence[Response], flat: Array) -> list[Array]:
    """Splits the sequence `flat` of all fitted coefficients into the responses (3, p, n) of each triad."""
    ends = np.cumsum([one.values.size for one in fitted])
    parts = np.split(flat, ends[:-1])
    return [part.reshape(3, -1, flat.shape[1]) for part in parts]


def _rotation(reference: Response, values: Array) -> Array:
    """Returns the rotations (3, 3, n) from the frame of the fixture to a triad's own frame, for the responses `values` (3, p, n) of
    the triad."""
    factors = np.array([own.factor for own in reference.units])[:, None, None]
    try:
        return own_frame(values[:, [reference.sensed[k] for k in range(3)]] * factors)
    except ValueError as error:
        raise EstimationError(f"no frame can be defined by the {reference.kind} outputs: {error}") from None


def _turned(one: Response, values: Array, rotation: Array) -> Array:
    """Transforms responses to another frame: the responses to rates and the responses to specific forces in `values` (3, p, n).
    `rotation`: array of shape (3, 3, n), the rotation from the old frame to the new one."""
    turned = np.array(values)
    for places in (one.places("rate"), one.places("accel")):
        if places:
            listed = [places[k] for k in range(3)]
            turned[:, listed] = np.einsum("akn,jkn->ajn", values[:, listed], rotation)
    return turned


def _must_turn(responses: Sequence[Response]) -> None:
    """Raises `EstimationError` if the responses of a model cannot be transformed to another frame."""
    for one in responses:
        rates, forces = one.places("rate"), one.places("accel")
        known = {"bias", *(f"{name}_{axis}" for name in ("rate", "accel") for axis in AXES)}
        others = [name for name in one.model.names if name not in known]
        if others:
            raise EstimationError(
                f"the term {others[0]} cannot be transformed to another frame: write `misalignment: full`"
            )
        if len(one.sensed) < 3 or any(len(places) not in (0, 3) for places in (rates, forces)):
            raise EstimationError(
                "a lower triangular matrix needs all three axes of each term: write `misalignment: full`"
            )


@dataclass(frozen=True, slots=True)
class _Part:
    """One reported quantity of one output. The value of the quantity is `factor` times the result of `of`. The function `of` takes
    the responses of the output, in the output's unit per SI unit of the term."""

    reported: Reported
    of: RowFormula
    factor: float


def _axis(one: Response, axis: int, own_frame_: bool) -> list[_Part]:
    """Returns the reported quantities of the output along `axis`. `own_frame_`: True if the results are in the own frame of a
    triad, False for the frame of the fixture."""
    own, letter = one.units[axis], AXES[axis]
    direct = own.dimension == _DIMENSION[one.kind]
    plain = _BIAS[one.kind] if direct else f"({own.text})"
    sensed, names = one.sensed, one.model.names
    found: list[_Part] = []

    def add(name: str, text: str, of: RowFormula, words: Said, si: float = own.factor) -> None:
        """Adds a reported quantity of the output. `text`: unit of the reported quantity. `si`: SI value of the unit in which `of`
        gives its result."""
        try:
            factor = si / unit(text).factor
        except UnknownUnitError as error:
            raise EstimationError(f"the coefficient {one.kind}_{name} has an unknown unit: {error}") from None
        found.append(_Part(Reported(f"{one.kind}_{name}", text, words), of, factor))

    def place(k: int) -> RowFormula:
        return lambda row: np.asarray(row[k])

    if "bias" in names:
        add(
            f"bias_{letter}",
            _BIAS[one.kind] if direct else own.text,
            place(names.index("bias")),
            said("Bias of output {axis}", axis=letter),
        )
    if axis in sensed and not one.values[axis, list(sensed.values())].any():
        raise UnfitDataError(
            f"output {letter} of the {PLURAL[one.kind]} does not respond at all: check whether it is connected"
        )
    per = "1" if direct else f"({own.text})/({_PER[one.kind]})"
    for direction, part in scale_and_misalignments(sensed, axis).items():
        across = f"misalignment_{letter}_{AXES[direction]}"
        if direction == axis:
            add(
                f"scale_{letter}",
                per,
                part,
                said("Scale factor of output {axis}, along its own input axis", axis=letter),
            )
        elif axis not in sensed:
            add(
                across, per, part, said("Response of output {axis} along {across}", axis=letter, across=AXES[direction])
            )
        elif not (own_frame_ and direction > axis):
            add(
                across,
                "mrad",
                part,
                said("Component of the input axis {axis} along {across}", axis=letter, across=AXES[direction]),
                1.0,
            )
    across_g = one.places("accel") if one.kind == "gyro" else {}
    for direction, k in across_g.items():
        words = said("Response of output {axis} to specific force along {along}", axis=letter, along=AXES[direction])
        add(f"g_sensitivity_K_{AXES[direction]}_{letter}", f"{plain}/g", place(k), words)
    for k, term in enumerate(one.model.terms):
        if term.name != "bias" and k not in sensed.values() and k not in across_g.values():
            column = _COLUMNS.get(term.unit, f"({term.unit})")
            text = plain if term.unit == "1" else f"{plain}/{column}"
            add(
                f"{term.name}_{letter}",
                text,
                place(k),
                said("Output {output}: {term}", output=letter, term=term.description),
            )
    return found
