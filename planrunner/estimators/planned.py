"""Computes what estimators need to know about planned segments before anything is recorded: design matrices for segments at rest,
and the expected noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import closest
from planrunner.error_model.terms import ErrorModel, columns_of
from planrunner.estimators.interface import DesignBlock, DesignRequest, EstimationError
from planrunner.instruments.models import NoiseModel
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import Poses, StimulusError
from planrunner.plan.schedule import Rest, Segment


def matrix_at_rest(
    model: ErrorModel, segments: Sequence[Segment], site: Site, needed: str, otherwise: str = ""
) -> Array:
    """Returns the design matrix, SI, shape (n, p). All segments must be at rest.

    Raises `EstimationError` for a segment that moves, and for an unknown orientation. `needed`: the reason why segments must be at
    rest, as part of the first message. `otherwise`: a text that is appended to the message about an unknown orientation.
    """
    moving = [segment.label for segment in segments if not isinstance(segment.motion, Rest)]
    if moving:
        raise EstimationError(f"segment '{moving[0]}' moves: {needed}; leave it out of `segments`")
    try:
        return columns_of(model, Poses.of(segments), site)
    except StimulusError as error:
        raise EstimationError(f"{error}{otherwise}") from None


def planned_blocks(
    request: DesignRequest[object], outputs: Sequence[str], terms: tuple[str, ...], matrix: Array, magnitudes: Array
) -> tuple[DesignBlock, ...]:
    """Returns one block for each output. A block contains the design matrix of segments at rest, SI, shape (n, p), and the noise
    that the sensor declares for the planned dwells.

    A dwell of unknown length counts as one second. Raises `EstimationError` for an output that the sensor does not have.
    """
    labels = tuple(segment.label for segment in request.segments)
    blocks = []
    for name in outputs:
        output = request.sensor.output(name)
        if output is None:
            hint = closest(name, [item.name for item in request.sensor.outputs])
            raise EstimationError(f"the bench's sensor has no output '{name}': {hint}")
        blocks.append(DesignBlock(name, terms, matrix, magnitudes, _sigma(request, output.noise), labels))
    return tuple(blocks)


def _sigma(request: DesignRequest[object], noise: NoiseModel) -> Array:
    return np.array(
        [
            noise.standard_error(segment.dwell or 1.0, segment.sample_rate or request.sensor.sample_rate)
            for segment in request.segments
        ]
    )
