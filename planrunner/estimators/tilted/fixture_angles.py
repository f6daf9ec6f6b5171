"""Determines the angles of a fixture's axes from spins about one rotation axis in several orientations of the fixture.

Let an axis have the scale factor K and the direction d, a unit vector. If the table turns at the rate ω about the direction n, the
output is K·(d·n)·ω. Both unit vectors are given in the fixture's frame. Each orientation of the fixture on the table gives one
component of the gain vector K·d. Three orientations whose vectors n are not in one plane give the complete gain vector. K, the
angle from the fixture's z axis, and the azimuth follow from this vector. Two orientations give K and the angle if the azimuth is
stated. Orientations with the same n, or with the opposite n, give no information on the angle. An error that all rates have in
common does not affect the angles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.basis_judgement import judge, planned_basis, require_basis
from planrunner.estimators.derived import Derived, Reported, derived
from planrunner.estimators.drift_order import planned_drift
from planrunner.estimators.expected import planned_blocks
from planrunner.estimators.fit_tables import drift_tables, residual_plot
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignBlock,
    DesignRequest,
    EstimateRequest,
    EstimationError,
    Remark,
)
from planrunner.estimators.method import Method, Quantities, Words
from planrunner.estimators.outputs_fit import OutputsFit, coefficients_by_noise, fit_outputs, uncertainty_basis
from planrunner.estimators.tables import Role, Table, TableColumn, by_columns
from planrunner.estimators.tilted.fixture_gains import (
    FITTED,
    STATED,
    GainModel,
    gain_basis,
    gain_model,
    held_rates,
    polar,
    stated_conditions,
)
from planrunner.estimators.tilted.mounted_axes import MountedAxes, mounted_axes
from planrunner.estimators.tilted.rate_lines import rate_and_output, slope_unit
from planrunner.estimators.tilted.turning_rates import recorded_seconds
from planrunner.observation.drift import drift, drift_of, thermometer
from planrunner.observation.flicker import SPAN, flicker_errors, unstated_flicker
from planrunner.observation.observations import Observations, observe
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Record, Text, key
from planrunner.plan.units import unit
from planrunner.uncertainty.conditions import influences_on
from planrunner.uncertainty.influences import Influence

_DEGREE, _ARCSEC = unit("deg").factor, unit("arcsec").factor
_WORDS = (
    said("scale factor along the axis"),
    said("angle from the fixture's z axis"),
    said("azimuth about the fixture's z axis, from x"),
)


class FixtureAnglesParameters(Record):
    """Declares the plan keys of the estimator `fixture_angles`."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1, single=True),
        "Channels to use; the end of a channel's name gives its axis in `mounting`. By default one channel for every axis.",
        ["gyro_x", "gyro_y", "gyro_z"],
        default_factory=tuple,
    )
    azimuth: str = key(
        Choice((FITTED, STATED)),
        "The axes' azimuths in the fixture: fitted, which needs three orientations, or taken from "
        "`mounting`, which needs only two.",
        FITTED,
        default=FITTED,
    )
    rate_unit: str = key(
        Text("", "a unit of angular rate"), "Unit of the table's rate in the results.", "deg/s", default="deg/s"
    )
    uncertainty: str = uncertainty_basis()
    drift: tuple[str, ...] = drift()
    temperature_channel: str | None = thermometer()


@dataclass(frozen=True, slots=True, kw_only=True)
class FixtureQuantities(Quantities):
    """Contains the observations and the fit of each axis, and the results."""

    axes: MountedAxes
    fits: tuple[tuple[Observations, OutputsFit], ...]


class FixtureAngles(Method[FixtureAnglesParameters, FixtureQuantities]):
    """Implements the estimator `fixture_angles`."""

    name = "fixture_angles"
    summary = "Angles of the axes in a fixture, from spins about one axis in two or more orientations of the fixture"
    Parameters = FixtureAnglesParameters

    def design(self, request: DesignRequest[FixtureAnglesParameters]) -> Design:
        """Checks, for each output, which components of the gain vector the planned orientations determine. Raises `EstimationError`
        if the plan is not suitable."""
        how = request.parameters.azimuth
        outputs = [output.name for output in request.sensor.outputs]
        axes = mounted_axes(request.setup.mounting, outputs, request.parameters.outputs)
        seconds = [segment.dwell for segment in request.segments]
        model = gain_model(request.segments, seconds, request.site, request.setup)
        blocks: list[DesignBlock] = []
        for k, name in enumerate(axes.outputs):
            basis = gain_basis(axes, k, how)
            blocks += planned_blocks(request, [name], model.terms(how), model.matrix(basis), model.magnitudes(basis))
        parameters = request.parameters
        remarks = (
            *_remarks(model, how),
            *planned_basis(request, blocks, parameters.uncertainty),
            *planned_drift(request, blocks),
        )
        return Design(tuple(blocks), remarks=remarks)

    def quantities(self, request: EstimateRequest[FixtureAnglesParameters]) -> FixtureQuantities:
        """Computes the angles from the means. Raises `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        if not request.segments:
            raise EstimationError("no recorded segments are chosen: check the labels in `segments`")
        axes = mounted_axes(request.setup.mounting, request.segments[0].statistics.channels, parameters.outputs)
        seconds = [recorded_seconds(one) for one in request.segments]
        model = gain_model([one.segment for one in request.segments], seconds, request.site, request.setup)
        fits: list[tuple[Observations, OutputsFit]] = []
        for k, name in enumerate(axes.outputs):
            basis = gain_basis(axes, k, parameters.azimuth)
            observations = observe(request.segments, [name], request.sensor)
            asked = model.matrix(basis), observations, model.magnitudes(basis), model.terms(parameters.azimuth)
            about = basis @ coefficients_by_noise(*asked)[0, len(model.orientations) :]
            flicker = flicker_errors(observations, request.setup.inputs, SPAN.value)
            effects = (*flicker, *held_rates(model, request.setup, about))
            courses = drift_of(
                parameters.drift, parameters.temperature_channel, observations, request.segments, request.segments
            )
            drift = replace(courses, fits=len(axes.outputs))
            unstated = unstated_flicker(observations, request.setup.inputs, SPAN.value)
            fit = fit_outputs(*asked, parameters.uncertainty, effects=effects, drift=drift, unstated=unstated)
            require_basis(fit, parameters.uncertainty, request.name)
            fits.append((observations, fit))
        found = _derived(request, model, axes, fits)
        acting = [_acting(request, model, axes, k, fit) for k, (_, fit) in enumerate(fits)]
        return FixtureQuantities(
            coefficients=found.coefficients(parameters.uncertainty),
            covariance=found.covariance(parameters.uncertainty),
            influences=found.influences(acting),
            unstated=found.unstated,
            axes=axes,
            fits=tuple(fits),
        )

    def words(self, request: EstimateRequest[FixtureAnglesParameters], found: FixtureQuantities) -> Words:
        """Makes the tables of the estimated and the stated angles, and of the residuals."""
        parameters = request.parameters
        notes: list[Said] = []
        warnings: list[Said] = []
        for _, fit in found.fits:
            judged = judge(fit, parameters.uncertainty)
            notes += [text for text in judged.texts if text not in notes]
            warnings += judged.warnings
        return Words(
            headline=tuple(item.name for item in found.coefficients),
            settings={"uncertainty": parameters.uncertainty, "azimuth": parameters.azimuth},
            tables=(
                _table(found.axes, found.coefficients),
                *drift_tables([fit for _, fit in found.fits], parameters.uncertainty),
            ),
            plots=tuple(
                residual_plot(observations, fit, f"Residuals of {name}", "segment")
                for name, (observations, fit) in zip(found.axes.outputs, found.fits, strict=True)
            ),
            notes=tuple(notes),
            warnings=tuple(warnings),
            segments=tuple(one.label for one in request.segments),
        )


def _derived(
    request: EstimateRequest[FixtureAnglesParameters],
    model: GainModel,
    axes: MountedAxes,
    fits: Sequence[tuple[Observations, OutputsFit]],
) -> Derived:
    """Computes the results from the offsets and gains of all axes: for each axis, the scale factor K, the angle and, if it is
    fitted, the azimuth, in the units of the results."""
    offsets, shapes = len(model.orientations), []
    reported: list[Reported] = []
    for k, (observations, fit) in enumerate(fits):
        text, factor = slope_unit(*rate_and_output(request.parameters.rate_unit, observations.units[0]))
        gain = fit.coefficients[0, offsets:]
        shapes.append((polar(gain, gain_basis(axes, k, request.parameters.azimuth), axes, k), factor))
        for word, own, words in list(zip(("K", "angle", "azimuth"), (text, "deg", "deg"), _WORDS, strict=True))[
            : len(gain)
        ]:
            period = 360.0 if word == "azimuth" else math.inf
            described = said("{axis}: {quantity}", axis=axes.names[k], quantity=words)
            reported.append(Reported(f"{word}_{axes.names[k]}", own, described, period))

    def formula(flat: Array) -> Array:
        made = []
        for own, (shape, factor) in zip(np.split(flat, len(fits)), shapes, strict=True):
            values = shape(own[offsets:])
            made += [values[:1] * factor, values[1:] / _DEGREE]
        return np.concatenate(made)

    return derived(reported, formula, *(fit for _, fit in fits))


def _acting(
    request: EstimateRequest[FixtureAnglesParameters], model: GainModel, axes: MountedAxes, k: int, fit: OutputsFit
) -> tuple[Influence, ...]:
    """Returns the influences of stated inputs on the offsets and gains of axis k."""

    def answered(matrix: Array) -> Array:
        """Returns the change of the fitted coefficients if the design matrix changes to `matrix`. The outputs themselves stay the
        same. A change of the expected outputs therefore has the same effect on the fit as the opposite change of the recorded
        outputs."""
        return np.asarray(-fit.gains[0] @ matrix @ fit.coefficients[0])

    stated = stated_conditions(model, request.setup, request.site, axes, k, request.parameters.azimuth)
    return (*influences_on(answered, stated), *fit.influences(request.parameters.uncertainty))


def _remarks(model: GainModel, azimuth: str) -> list[Remark]:
    if model.directions >= (3 if azimuth == FITTED else 2):
        return []
    seen = {0: "no direction", 1: "one direction (or its reverse)", 2: "directions in one plane"}[model.directions]
    hint = (
        "add an orientation in which the table turns about a third direction of the fixture, or write `azimuth: stated`"
    )
    if model.directions < 2:
        hint = (
            "add an orientation in which the table turns about another direction of the fixture: for example about another of its "
            "axes, or about a direction at a known angle to its z axis"
        )
    return [Remark("physics-fixture", f"the table turns about only {seen} of the fixture", hint)]


def _table(axes: MountedAxes, found: Sequence[Coefficient]) -> Table:
    angles = [one for one in found if one.name in {f"angle_{name}" for name in axes.names}]
    off = [float((one.value * _DEGREE - own) / _ARCSEC) for one, own in zip(angles, axes.angles, strict=False)]
    uncertainties = [one.standard_uncertainty * _DEGREE / _ARCSEC for one in angles]
    return by_columns(
        "Angles of the fixture, found and stated",
        (TableColumn("axis"), axes.names[: len(angles)]),
        (TableColumn("angle stated"), [f"{math.degrees(own):.6g} deg" for own in axes.angles[: len(angles)]]),
        (TableColumn("angle found"), [f"{one.value:.6f} deg" for one in angles]),
        (TableColumn("found minus stated", Role.VALUE, "arcsec"), off),
        (TableColumn("u(angle), from the data only", Role.STANDARD_UNCERTAINTY, "arcsec"), uncertainties),
    )
