"""What a reader and a user of an IMU's calibration need: the matrix and its inverse, residuals, and both bases of uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.imu_coefficients import AXES, Framed, Reported, Response
from planrunner.estimators.interface import Table
from planrunner.estimators.observations import Observations
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.plan.units import unit
from planrunner.uncertainty.decision import expanded_uncertainty

Array = NDArray[np.float64]

_WORDS = {"gyro": ("ω", "deg/s"), "accel": ("f", "g")}


def formula(frame: Framed) -> str:
    """What to do with the coefficients."""
    known = {one.kind for one in frame.responses}
    parts = []
    if "gyro" in known:
        parts.append("gyros: ω = (S·M)⁻¹·(output − b − G·f)")
    if "accel" in known:
        parts.append("accelerometers: f = (S·M)⁻¹·(output − b)")
    where = (
        f"in the {frame.reference} triad's own frame" if frame.reference else "in the axes of the planned orientations"
    )
    return f"To calibrate an output, {where}: " + "; ".join(parts) + "."


def matrices(one: Response) -> tuple[Table, ...]:
    """S·M with b (and G), and the inverse, where all three axes were seen."""
    sensed = one.sensed
    if len(sensed) < 3:
        return ()
    letter, per = _WORDS[one.kind]
    forces = one.places("accel") if one.kind == "gyro" else {}
    bias = "bias" in one.model.names
    columns = ["output", "unit", *(f"{letter}_{axis} [per {per}]" for axis in AXES)]
    columns += ["b"] if bias else []
    columns += [f"G {AXES[k]} [per g]" for k in forces]
    rows = []
    for axis in range(3):
        row: list[object] = [AXES[axis], one.units[axis].text]
        row += [float(one.values[axis, sensed[k]] * unit(per).factor) for k in range(3)]
        row += [float(one.values[axis, one.model.names.index("bias")])] if bias else []
        row += [float(one.values[axis, place] * unit("g").factor) for place in forces.values()]
        rows.append(tuple(row))
    found = [Table(f"Matrix S·M of the {one.kind} triad", tuple(columns), tuple(rows))]
    if (inverse := inverse_matrix(one)) is not None:
        units = [own.text for own in one.units]
        heads = (letter, *(f"output {axis} [{per} per {text}]" for axis, text in zip(AXES, units, strict=True)))
        cells = tuple((axis, *map(float, row)) for axis, row in zip(AXES, inverse, strict=True))
        found.append(Table(f"Inverse (S·M)⁻¹ of the {one.kind} triad", heads, cells))
    return tuple(found)


def inverse_matrix(one: Response) -> Array | None:
    """(S·M)⁻¹, deg/s or g per recorded unit, shape (3, 3); None where the outputs do not span space."""
    matrix = one.values[:, [one.sensed[k] for k in range(3)]] * unit(_WORDS[one.kind][1]).factor
    lengths = np.linalg.norm(matrix, axis=1, keepdims=True)
    if (lengths == 0).any() or np.linalg.cond(matrix / lengths) > 1e6:
        return None
    return np.asarray(np.linalg.inv(matrix))


def residuals(kind: str, observations: Observations, fit: OutputsFit) -> Table:
    """Means, residuals and the noise within the segments."""
    columns = ["segment"]
    for name, text in zip(observations.channels, observations.units, strict=True):
        columns += [f"{name} mean [{text}]", f"{name} residual [{text}]", f"{name} u within [{text}]"]
    rows = []
    for n, label in enumerate(observations.labels):
        row: list[object] = [label]
        for k, (one, noise) in enumerate(zip(fit.fits, fit.noises, strict=True)):
            within = float(noise.sigma[n]) if noise.known else None
            row += [float(observations.mean[n, k]), float(one.residuals[n]), within]
        rows.append(tuple(row))
    return Table(f"Residuals of the {kind} triad", tuple(columns), tuple(rows))


def both_bases(found: Reported, bases: Sequence[str], spread: Callable[[str], tuple[Array, Array]]) -> Table:
    """Every coefficient's uncertainty by what the data show, on each basis that they give. spread: basis → (u, degrees of freedom)."""
    columns = ["coefficient", "unit", "value"]
    cells = []
    for basis in bases:
        shown = basis.replace("_", " ")
        columns += [f"u ({shown})", f"dof ({shown})", f"U 95 % ({shown})"]
        cells.append(spread(basis))
    rows = []
    for q, name in enumerate(found.names):
        row: list[object] = [name, found.units[q], float(found.values[q])]
        for u, freedom in cells:
            row += [float(u[q]), float(freedom[q]), expanded_uncertainty(float(u[q]), float(freedom[q]))]
        rows.append(tuple(row))
    return Table("Uncertainties of the data, on either basis", tuple(columns), tuple(rows))
