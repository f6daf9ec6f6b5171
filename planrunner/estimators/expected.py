"""Computes the expected data of a schedule before anything is recorded: the design matrices of segments at rest, the noise of the
means of these segments, and an expected recording. The segments of the expected recording have the means that a nominal sensor
would give, and the declared noise.

From the expected recording, an estimator computes the nominal value of every coefficient of a run
(`planrunner.estimators.method`). For quantities that neither the plan nor the bench states, two different sets of values are
assumed. A coefficient that is equal for both sets does not depend on the assumptions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from planrunner.archive.recording import BATCHES, RecordedSegment, Statistics, expected_segment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.error_model.observed import STANDARD_PRESSURE, planned_excess
from planrunner.error_model.terms import ErrorModel, columns_of
from planrunner.estimators.full_scale import input_direction
from planrunner.estimators.interface import DesignBlock, DesignRequest, EstimationError
from planrunner.instruments.models import OutputModel
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import Poses, Stimulus, StimulusError
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.plan.units import DIMENSIONS, UnknownUnitError, unit


def planned_sampling(request: DesignRequest[object]) -> tuple[Array, Array]:
    """Returns the planned durations [s] and sample rates [Hz] of the segments, each of shape (n,). A dwell of unknown length counts
    as one second."""
    seconds = np.array([segment.dwell or 1.0 for segment in request.segments])
    rates = np.array([segment.sample_rate or request.sensor.sample_rate for segment in request.segments])
    return seconds, rates


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

    Raises `EstimationError` for an output that the sensor does not have.
    """
    labels = tuple(segment.label for segment in request.segments)
    seconds, rates = planned_sampling(request)
    blocks = []
    for name in outputs:
        output = request.sensor.output(name)
        if output is None:
            hint = closest(name, [item.name for item in request.sensor.outputs])
            raise EstimationError(f"the bench's sensor has no output '{name}': {hint}")
        blocks.append(DesignBlock(name, terms, matrix, magnitudes, output.noise.standard_error(seconds, rates), labels))
    return tuple(blocks)


Responses = Mapping[str, tuple[ErrorModel, Array]]
"""For each output: an error model, and the coefficients (p,) that the sensor declares. Coefficients are in the unit of the output
divided by the SI unit of their column."""

_ALONG_UP = np.eye(3)


@dataclass(frozen=True, slots=True)
class Known:
    """States what an estimator knows about the outputs; the keys are names of outputs. `responses`: the error model and its
    coefficients, as declared for the sensor. `directions`: the input axis (3,), in the sensor's frame, of each output for which the
    keys of the estimator define this axis."""

    responses: Responses = field(default_factory=dict)
    directions: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Assumption:
    """Contains assumed values for quantities that neither the plan nor the bench file states.

    `noise`: standard error of a mean, in the output's unit. `gain`: output per SI unit of the sensed quantity. `kelvin`:
    temperature in K. `attitude`: array of shape (3, 3), the assumed attitude.
    """

    noise: float
    gain: float
    kelvin: float
    attitude: Array


ASSUMPTIONS = (
    Assumption(1e-3, 1.0, 298.15, _ALONG_UP),
    Assumption(2e-3, 1.5, 313.15, np.array([[0.0, 0.8, 0.6], [0.0, -0.6, 0.8], [1.0, 0.0, 0.0]])),
)


@dataclass(frozen=True, slots=True)
class Expected:
    """Contains an expected recording and the assumptions that it needs. `segments`: the expected recording. `assumed`: sentences
    about the assumptions for the used outputs; empty if plan and bench state everything."""

    segments: tuple[RecordedSegment, ...]
    assumed: tuple[str, ...]


def expected_recording(
    request: DesignRequest[object], known: Known, used: Sequence[str], assumption: Assumption
) -> Expected:
    """Builds the recording that the schedule is expected to give. `known`: what the estimator knows about the outputs; everything
    else is derived from the names and units of the outputs. `used`: names of the outputs for which assumptions are reported."""
    outputs = request.sensor.outputs
    poses, assumed = _poses(request, assumption)
    felt = poses.felt(request.site)
    means, errors, variances = (np.zeros((len(request.segments), len(outputs))) for _ in range(3))
    seconds, rates = planned_sampling(request)
    counts = np.maximum(1, np.round(seconds * rates)).astype(int)
    for k, output in enumerate(outputs):
        if (declared := known.responses.get(output.name)) is not None:
            model, coefficients = declared
            means[:, k], nominal = columns_of(model, poses, request.site) @ coefficients, True
        else:
            means[:, k], nominal = _means(request, output, known, felt, assumption)
        noise = output.noise
        variances[:, k] = noise.white**2 * rates
        # Rounding that does not average out shifts the means, but causes no scatter.
        rounding = noise.rounding(counts, variances[:, k]) * noise.dithers(variances[:, k])
        errors[:, k] = np.sqrt(noise.white**2 / np.maximum(seconds, 1 / rates) + rounding)
        silent = not noise.white and not noise.resolution
        if silent:
            errors[:, k] = assumption.noise
        if output.name in used:
            assumed += [f"the bench declares no noise of '{output.name}'"] if silent else []
            assumed += [] if nominal else [f"the bench declares no scale factor of '{output.name}'"]
    names, units = tuple(output.name for output in outputs), {output.name: output.unit for output in outputs}
    covariances = variances[:, :, None] * np.eye(len(outputs))
    made = []
    for row, segment in enumerate(request.segments):
        count, period = int(counts[row]), 1 / float(rates[row])
        statistics = Statistics(
            names, count, 0, means[row], means[row], means[row], covariances[row], errors[row], min(BATCHES, count),
            segment.start, segment.start + (count - 1) * period, period if count > 1 else 0.0,
        )  # fmt: skip
        made.append(expected_segment(segment, units, statistics))
    return Expected(tuple(made), tuple(dict.fromkeys(assumed)))


def _poses(request: DesignRequest[object], assumption: Assumption) -> tuple[Poses, list[str]]:
    """Returns the poses of the segments, and sentences about the assumptions that they need. Rocking segments and cycles have the
    pose in which they begin."""
    assumed: list[str] = []
    segments: list[Segment] = []
    for segment in request.segments:
        if segment.attitude is None:
            # A spin in an unknown orientation is assumed to be about the z axis, from which mounting angles are measured.
            segment = replace(
                segment,
                attitude=_along(segment.motion.about) if isinstance(segment.motion, Spin) else assumption.attitude,
            )
            if not isinstance(segment.motion, Spin):
                assumed = [f"the orientation of segment '{segment.label}' is unknown"]
        segments.append(segment if isinstance(segment.motion, Rest | Spin) else replace(segment, motion=Rest()))
    return Poses.of(segments), assumed


def _along(about: Sequence[float]) -> Array:
    """Returns an attitude (3, 3) whose z axis is the direction `about`."""
    z = np.asarray(about, dtype=float) / np.linalg.norm(about)
    x = np.eye(3)[int(np.abs(z).argmin())]
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.array([x, np.array([z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]]), z])


def _means(
    request: DesignRequest[object],
    output: OutputModel,
    known: Known,
    felt: Stimulus,
    assumption: Assumption,
) -> tuple[Array | float, bool]:
    """Returns the expected means (n,) of an output in the n segments, and True if these means depend only on declared values. The
    quantity that the output measures is determined from its unit."""
    try:
        own = unit(output.unit)
    except UnknownUnitError:
        return assumption.gain, False
    if own.dimension == DIMENSIONS["temperature"]:
        kelvin = np.where(np.isfinite(felt.temperature), felt.temperature, assumption.kelvin)
        return (kelvin - own.offset) / own.factor, True
    if own.dimension in (DIMENSIONS["voltage"], DIMENSIONS["pressure"]) and output.senses is None:
        excess = np.array([planned_excess(one, request.sensor.nominal_supply) for one in request.segments])
        supply, pressure = request.sensor.nominal_supply + excess[:, 0], STANDARD_PRESSURE + excess[:, 1]
        return (supply if own.dimension == DIMENSIONS["voltage"] else pressure) / own.factor, True
    turns, forced = (own.dimension == DIMENSIONS[name] for name in ("angular rate", "acceleration"))
    if not (turns or forced or output.senses or own.dimension == unit("pulse/s").dimension):
        return 0.0, True  # an encoder or a position, which no inertial effect changes
    input_ = felt.specific_force if forced or output.senses == "acceleration" else felt.omega
    direction = known.directions.get(output.name)
    if direction is None:
        direction = input_direction(request.setup.mounting, output.name)
    along = input_ @ (np.array([0.0, 0.0, 1.0]) if direction is None else direction)
    gain = request.sensor.nominal.get(f"K_{output.name}", 1.0 if turns or forced else math.nan) / own.factor
    return along * (gain if math.isfinite(gain) else assumption.gain), math.isfinite(gain)
