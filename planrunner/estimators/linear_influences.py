"""All that was stated of a bench and reaches coefficients fitted from positions at rest: their influences, in one list.

Site and orientation come from `stated_influences`; here are added the right angles between the table's axes and the outputs' resolution,
which is in the data on either basis (see `observations`), and listed only. What acts on each position in its own way, as the table's
position errors do, belongs to the fit's weights (`observation_effects`) and comes from the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.interface import DesignRequest, EstimateRequest
from planrunner.estimators.observation_effects import functionals_of
from planrunner.estimators.resolution_influences import resolution_influences
from planrunner.estimators.stated_influences import stated_influences
from planrunner.instruments.models import TableModel
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable, joint_angles, rotation_about
from planrunner.physics.stimulus import segment_means
from planrunner.physics.terms import ErrorModel
from planrunner.plan.schedule import Rest, Segment
from planrunner.uncertainty.influences import Influence, InputQuantity

Array = NDArray[np.float64]

_STEP = 1e-3  # rad; central differences of terms up to the second degree are exact for any step


def linear_influences(
    request: EstimateRequest | DesignRequest,
    model: ErrorModel,
    outputs: Sequence[str],
    coefficients: Array,
    gains: Array,
) -> tuple[Influence, ...]:
    """Influences on all coefficients, output after output, in SI columns and the outputs' units.

    coefficients: (m, p) of m outputs; gains: (m, p, n), coefficients from observations.
    """
    segments = [one.segment if isinstance(one, RecordedSegment) else one for one in request.segments]
    inputs, table = request.setup.inputs, request.setup.table
    found = list(stated_influences(model, segments, request.site, inputs, coefficients, gains))
    orthogonality = inputs.get("table orthogonality")
    if orthogonality is not None and table is not None:
        found += _orthogonality(orthogonality, table, model, segments, request.site, coefficients, gains)
    if isinstance(request, EstimateRequest):
        found += resolution_influences(request, outputs, functionals_of(gains))
    return tuple(found)


def _orthogonality(
    quantity: InputQuantity,
    table: TableModel,
    model: ErrorModel,
    segments: Sequence[Segment],
    site: Site,
    coefficients: Array,
    gains: Array,
) -> list[Influence]:
    """One column for each pair of neighbouring axes; nothing where the table cannot be at the orientations."""
    if len(table.axes) < 2 or not all(isinstance(segment.motion, Rest) for segment in segments):
        return []
    try:
        tilts = orthogonality_tilts(table.axes, [segment.attitude for segment in segments], site.azimuth)
    except Unreachable:
        return []
    felt = segment_means(segments, site)
    columns, parts = [], []
    for k, tilt in enumerate(tilts):
        turned = [
            replace(
                felt,
                omega=felt.omega + step * np.cross(tilt, felt.omega),
                specific_force=felt.specific_force + step * np.cross(tilt, felt.specific_force),
            )
            for step in (-_STEP, _STEP)
        ]
        low, high = (model.columns(one) for one in turned)
        change = (high - low) / (2 * _STEP) @ coefficients.T
        columns.append(-np.einsum("mpn,nm->mp", gains, change).ravel())
        parts.append(f"{table.axes[k].name} and {table.axes[k + 1].name}")
    return [Influence(quantity, np.column_stack(columns), parts=tuple(parts))]


def orthogonality_tilts(
    axes: Sequence[TableAxis], attitudes: Sequence[Array | None], azimuth: float
) -> tuple[Array, ...]:
    """How a table turns the sensor when neighbouring axes are not at right angles: for each pair, (n, 3), rad per rad.

    A vector v in the sensor's axes becomes v + tilt × v per radian by which the inner axis of the pair leans out of its right angle, about
    c = outer × inner. The table reads zero where it is aligned, so that at joint angle q of the inner axis the error is c − R(inner, −q)·c
    in its own frame, carried inwards by the joints beyond. The joints go from one attitude to the next the quickest way. Raises
    `Unreachable`.
    """
    near = np.zeros(len(axes))
    tilts = np.empty((len(axes) - 1, len(attitudes), 3))
    for n, attitude in enumerate(attitudes):
        if attitude is None:
            raise Unreachable("the orientation is unknown")
        near = joint_angles(axes, attitude, near, azimuth)
        inward = [rotation_about(axis.direction, -float(angle)) for axis, angle in zip(axes, near, strict=True)]
        for k in range(len(axes) - 1):
            lean = np.cross(axes[k].direction, axes[k + 1].direction)
            tilt = lean - inward[k + 1] @ lean
            for turn in inward[k + 2 :]:
                tilt = turn @ tilt
            tilts[k, n] = tilt
    return tuple(tilts)
