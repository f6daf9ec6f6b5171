"""Predicts the results of a plan's estimates from the schedule alone. Nothing in this module reads samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from planrunner.estimators.basis_judgement import few_samples
from planrunner.estimators.interface import (
    Design,
    DesignRequest,
    EstimationError,
    Estimator,
    FindsSpans,
    Setup,
    estimator_of,
)
from planrunner.estimators.method import designed
from planrunner.instruments.models import SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Segment
from planrunner.plan.selection import Detection, select


def design_of(
    name: str,
    spec: EstimateSpec,
    segments: Sequence[Segment],
    site: Site,
    sensor: SensorModel,
    designs: Mapping[str, Design],
    setup: Setup | None = None,
) -> Design:
    """Checks how well the planned segments determine the results of one estimate. Also predicts the coefficients of a run.

    `designs`: designs of the estimates that come before this one. Raises `EstimationError` if the segments are not suitable for the
    estimator.
    """
    missing = [used for used in spec.uses if used not in designs]
    if missing:
        raise EstimationError(f"it uses '{missing[0]}', which has no design")
    chosen = [segments[index] for index in select([segment.label for segment in segments], patterns_of(spec))]
    if not chosen:
        raise EstimationError(f"no segment has a label that matches {', '.join(patterns_of(spec))}")
    estimator = estimator_of(spec)
    uses = {used: designs[used] for used in spec.uses}
    detection = detection_of(spec, estimator)
    request = DesignRequest(name, tuple(chosen), spec.parameters, site, sensor, uses, setup or Setup(), detection)
    design = designed(estimator, request)
    if not design.blocks or isinstance(spec.segments, Detection):
        return design
    return replace(design, remarks=(*design.remarks, *few_samples(request)))


def detection_of(spec: EstimateSpec, estimator: Estimator[Record]) -> Detection | None:
    """Returns the settings with which spans are detected in the data; None if the plan names whole segments. Raises
    `EstimationError` if spans are to be detected, but the estimator uses whole segments."""
    if not isinstance(spec.segments, Detection):
        return None
    if not (isinstance(estimator, FindsSpans) and estimator.finds_spans):
        raise EstimationError(
            f"{spec.estimator} uses whole segments and does not search for spans in the data: name segments in `segments`"
        )
    return spec.segments


def patterns_of(spec: EstimateSpec) -> tuple[str, ...]:
    """Returns the label patterns of the segments that an estimate uses. If the estimate detects spans, these patterns select the
    segments in which spans are detected."""
    return spec.segments.within if isinstance(spec.segments, Detection) else tuple(spec.segments)
