"""Tables for users of an IMU calibration: its application, the matrices and their inverses."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.estimators.imu.coefficients import AXES, Framed, Response
from planrunner.estimators.interface import Cell, Role, Table, TableColumn
from planrunner.plan.units import unit

_WORDS = {"gyro": ("ω", "deg/s"), "accel": ("f", "g")}


def formula(frame: Framed) -> Said:
    """Explains how to apply the coefficients."""
    known = {one.kind for one in frame.responses}
    formulas = {
        "gyro": said("gyros: ω = (S·M)⁻¹·(output − b − G·f)"),
        "accel": said("accelerometers: f = (S·M)⁻¹·(output − b)"),
    }
    frames = {
        "gyro": said("in the gyro triad's own frame"),
        "accel": said("in the accel triad's own frame"),
        "": said("in the axes of the planned orientations"),
    }
    first, *others = (formula for kind, formula in formulas.items() if kind in known)
    if not others:
        return said("To calibrate an output, {frame}: {formula}.", frame=frames[frame.reference], formula=first)
    return said(
        "To calibrate an output, {frame}: {first}; {second}.",
        frame=frames[frame.reference],
        first=first,
        second=others[0],
    )


def matrices(one: Response) -> tuple[Table, ...]:
    """Tables of S·M with b (and G), and of the inverse if all three axes were excited."""
    sensed = one.sensed
    if len(sensed) < 3:
        return ()
    letter, per = _WORDS[one.kind]
    forces = one.places("accel") if one.kind == "gyro" else {}
    bias = "bias" in one.model.names
    columns = [TableColumn("output"), TableColumn("unit")]
    columns += [TableColumn(f"{letter}_{axis}", Role.VALUE, f"per {per}") for axis in AXES]
    columns += [TableColumn("b", Role.VALUE)] if bias else []
    columns += [TableColumn(f"G {AXES[k]}", Role.VALUE, "per g") for k in forces]
    rows = []
    for axis in range(3):
        row: list[Cell] = [AXES[axis], one.units[axis].text]
        row += [float(one.values[axis, sensed[k]] * unit(per).factor) for k in range(3)]
        row += [float(one.values[axis, one.model.names.index("bias")])] if bias else []
        row += [float(one.values[axis, place] * unit("g").factor) for place in forces.values()]
        rows.append(tuple(row))
    found = [Table(f"Matrix S·M of the {one.kind} triad", tuple(columns), tuple(rows))]
    if (inverse := inverse_matrix(one)) is not None:
        units = [own.text for own in one.units]
        outputs = (
            TableColumn(f"output {axis}", Role.VALUE, f"{per} per {text}")
            for axis, text in zip(AXES, units, strict=True)
        )
        cells: tuple[tuple[Cell, ...], ...] = tuple(
            (axis, *map(float, row)) for axis, row in zip(AXES, inverse, strict=True)
        )
        found.append(Table(f"Inverse (S·M)⁻¹ of the {one.kind} triad", (TableColumn(letter), *outputs), cells))
    return tuple(found)


def inverse_matrix(one: Response) -> Array | None:
    """The matrix (S·M)⁻¹, (3, 3), in deg/s or g per recorded unit; None if the input axes of the outputs are linearly dependent."""
    matrix = one.values[:, [one.sensed[k] for k in range(3)]] * unit(_WORDS[one.kind][1]).factor
    lengths = np.linalg.norm(matrix, axis=1, keepdims=True)
    if (lengths == 0).any() or np.linalg.cond(matrix / lengths) > 1e6:
        return None
    return np.asarray(np.linalg.inv(matrix))
