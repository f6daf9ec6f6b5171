"""Estimates the static coefficients of a flexure gyro from positions at rest: U0 … U5, V0 … V5 and the twelve physical coefficients
(CN100554884C)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.error_model import flexure_gyro
from planrunner.error_model.flexure_gyro import drifts
from planrunner.error_model.terms import ErrorModel
from planrunner.estimators import rank
from planrunner.estimators.basis_judgement import judge, planned_basis, require_basis
from planrunner.estimators.declared_axes import against_nominal
from planrunner.estimators.derived import Derived, Reported, derived
from planrunner.estimators.drift_order import planned_drift
from planrunner.estimators.expected import Known, matrix_at_rest
from planrunner.estimators.fit_positions import PositionsDesign, fit_positions, site_influences
from planrunner.estimators.fit_tables import bases_table, drift_tables, residual_plot, residual_table
from planrunner.estimators.interface import Design, DesignRequest, Estimate, EstimateRequest, EstimationError
from planrunner.estimators.method import Method, Quantities, Words
from planrunner.estimators.outputs_fit import BASES, OutputsFit, uncertainty_basis
from planrunner.estimators.resolution_influences import resolution_influences
from planrunner.observation.correlated_errors import functionals_of
from planrunner.observation.drift import drift, thermometer
from planrunner.observation.flicker import drift_span
from planrunner.observation.observations import Observations, observe, weights_of
from planrunner.physics.earth import Site
from planrunner.plan.kinds import CHANNEL, Boolean, Choice, ListOf, Record, key
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Segment
from planrunner.plan.units import unit
from planrunner.uncertainty.influences import Aspect, Influence
from planrunner.uncertainty.monte_carlo import Draws


class FlexureGyroStaticParameters(Record):
    """Declares the plan keys of the estimator `flexure_gyro_static`."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=2),
        "The two torquer outputs: first the x axis, then the y axis.",
        ["torquer_x", "torquer_y"],
        default=("torquer_x", "torquer_y"),
    )
    terms: tuple[str, ...] = key(
        ListOf(Choice(tuple(flexure_gyro.PRODUCTS)), single=True),
        "Product terms in addition to the static model; cardinal positions cannot determine them.",
        ["accel_x_accel_z"],
        default_factory=tuple,
    )
    uncertainty: str = uncertainty_basis("positions about the model", "positions")
    pool_outputs: bool = key(
        Boolean(),
        "With `uncertainty: residual`, use one common ratio of residual scatter to noise for both outputs, which doubles "
        "the degrees of freedom.",
        True,
        default=True,
    )
    drift_span: Quantity = drift_span()
    drift: tuple[str, ...] = drift()
    temperature_channel: str | None = thermometer()


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticQuantities(Quantities):
    """Contains the fitted static coefficients. `stated`: influences of declared inputs on the coefficients [U; V] in SI units."""

    observations: Observations
    design: PositionsDesign
    fit: OutputsFit
    found: Derived
    stated: tuple[Influence, ...]


class FlexureGyroStatic(Method[FlexureGyroStaticParameters, StaticQuantities]):
    """Implements the estimator `flexure_gyro_static`."""

    name = "flexure_gyro_static"
    summary = "Static coefficients of a two-axis flexure gyro from positions at rest"
    Parameters = FlexureGyroStaticParameters

    def design(self, request: DesignRequest[FlexureGyroStaticParameters]) -> Design:
        """Checks the design of both outputs at the planned positions. Raises `EstimationError` if the plan is not suitable."""
        parameters = request.parameters
        design = static_design(parameters.terms, request.segments, request.site)
        blocks = design.blocks(request, _two(parameters.outputs))
        if rank.look(design.matrix / design.magnitudes).rank < len(design.magnitudes):
            return Design(blocks)
        remarks = (
            *planned_basis(request, blocks, parameters.uncertainty),
            *planned_drift(request, blocks),
        )
        known, note = information(design)
        return Design(blocks, notes=(note,), extra=known, remarks=remarks)

    def known(self, request: DesignRequest[FlexureGyroStaticParameters]) -> Known:
        """Returns the declared coefficients U and V of the sensor. If none are declared, returns the coefficients of a gyro without
        drift."""
        parameters = request.parameters
        nominal, names = request.sensor.nominal, flexure_gyro.physical_names(parameters.terms)
        if any(name not in nominal for name in names[:4]):
            return Known()
        outputs = flexure_gyro.output_coefficients(np.array([nominal.get(name, 0.0) for name in names]))
        model = flexure_gyro.static_model(parameters.terms)
        return Known({name: (model, own) for name, own in zip(parameters.outputs, outputs, strict=True)})

    def quantities(self, request: EstimateRequest[FlexureGyroStaticParameters]) -> StaticQuantities:
        """Computes the coefficients from the means of the positions. Raises `EstimationError` if the plan or the data are not
        suitable."""
        parameters = request.parameters
        basis = parameters.uncertainty
        observations = observe(request.segments, _two(parameters.outputs), request.sensor)
        design = static_design(parameters.terms, [one.segment for one in request.segments], request.site)
        fit = fit_positions(request, design, observations, request.segments, parameters.pool_outputs)
        require_basis(fit, basis, request.name)
        try:
            found = static_coefficients(fit, observations.units, design.model, parameters.terms)
        except ValueError as error:
            raise EstimationError(f"{request.name}: {error}") from None
        stated = (
            *site_influences(request, design, fit),
            *resolution_influences(request, parameters.outputs, functionals_of(fit.gains)),
            *fit.influences(basis),
        )
        return StaticQuantities(
            coefficients=found.coefficients(basis),
            covariance=found.covariance(basis),
            influences=found.influences([stated]),
            unstated=found.unstated,
            extra=_extra(observations, design, fit, parameters),
            observations=observations,
            design=design,
            fit=fit,
            found=found,
            stated=stated,
        )

    def words(self, request: EstimateRequest[FlexureGyroStaticParameters], found: StaticQuantities) -> Words:
        """Makes the tables of the residuals, of the uncertainties of each kind, and of the determinant of the positions."""
        fit, basis = found.fit, request.parameters.uncertainty
        judged = judge(fit, basis)
        notes, warnings = list(judged.texts), list(judged.warnings)
        warnings += against_nominal(
            (one.name, one.value * unit(one.unit).factor, nominal)
            for one in found.coefficients
            if one.name in flexure_gyro.SCALE_FACTORS and (nominal := request.sensor.nominal.get(one.name))
        )
        notes.append(information(found.design)[1])
        return Words(
            headline=flexure_gyro.physical_names(request.parameters.terms),
            settings={
                "uncertainty": basis,
                "pool_outputs": fit.pooled,
                "terms": list(found.design.model.names),
                "weights": weights_of(found.observations.channels, fit.noises),
            },
            tables=(
                residual_table("Residuals per position", "position", found.observations, fit),
                *drift_tables([fit], basis),
                bases_table(found.found, basis, len(flexure_gyro.physical_names(request.parameters.terms))),
            ),
            plots=(residual_plot(found.observations, fit),),
            notes=tuple(notes),
            warnings=tuple(warnings),
            segments=found.observations.labels,
        )

    def chain(self, request: EstimateRequest[FlexureGyroStaticParameters], estimate: Estimate) -> Draws:
        """Draws the coefficients by the Monte Carlo method. [U; V] are drawn from the fit and the stated inputs; the closed-form
        inverse then gives the physical coefficients of each draw."""
        made = self.quantities(request)
        return made.found.draws(request.parameters.uncertainty, [made.stated])


def static_design(products: tuple[str, ...], segments: Sequence[Segment], site: Site) -> PositionsDesign:
    """Returns the design of each output. All segments must be at rest. Raises `EstimationError` if a segment moves or its
    orientation is unknown."""
    model = flexure_gyro.static_model(products)
    return PositionsDesign(model, tuple(segments), static_matrix(model, segments, site), local_magnitudes(model, site))


def static_matrix(model: ErrorModel, segments: Sequence[Segment], site: Site) -> Array:
    """Returns the design matrix, SI, shape (n, p). All n segments must be at rest. Raises `EstimationError` for a segment that
    moves or whose orientation is unknown."""
    return matrix_at_rest(model, segments, site, "the static coefficients need positions at rest")


def local_magnitudes(model: ErrorModel, site: Site) -> Array:
    """Computes the magnitudes of the columns, shape (p,), from the Earth rate and gravity at the site. Determinants of columns that
    are divided by these magnitudes can be compared between sites."""
    sizes = {0: 1.0, 1: site.gravity, 2: site.gravity**2}
    return np.array([site.earth_rate if term.unit == "rad/s" else sizes[term.degree] for term in model.terms])


@lru_cache(maxsize=32)
def reported(
    units_of_outputs: tuple[str, ...], model: ErrorModel, products: tuple[str, ...]
) -> tuple[tuple[Reported, ...], Array]:
    """Returns the q reported quantities, and the SI values of their units, shape (q,). The physical coefficients come first,
    followed by U0 … and V0 ….

    The unit of a coefficient is derived from the units in which the outputs are recorded.

    Raises `EstimationError` if the two outputs have different units.
    """
    i_x, i_y = units_of_outputs
    if i_x != i_y:
        raise EstimationError(
            f"the two outputs are recorded in different units ({i_x} and {i_y}): record both in the same unit"
        )
    arcmin, rate, g = unit("arcmin").factor, unit("deg/h").factor, unit("g").factor
    drifts = [("deg/h", rate), *[("deg/h/g", rate / g)] * 3, *[("deg/h/g^2", rate / g**2)] * len(products)]
    per = {
        "1": (i_x, 1.0),
        "rad/s": (f"({i_x})/(deg/h)", 1 / rate),
        "m/s^2": (f"({i_x})/g", 1 / g),
        "(m/s^2)^2": (f"({i_x})/g^2", 1 / g**2),
    }
    outputs = [per[term.unit] for term in model.terms]
    scale = (f"(deg/h)/({i_x})", rate)
    shown = [scale, scale, ("arcmin", arcmin), ("arcmin", arcmin), *drifts, *drifts, *outputs, *outputs]
    names_u, names_v = flexure_gyro.output_names(products)
    names = (*flexure_gyro.physical_names(products), *names_u, *names_v)
    quantities = tuple(
        Reported(name, text, words) for name, (text, _), words in zip(names, shown, descriptions(products), strict=True)
    )
    factors = np.array([factor for _, factor in shown])
    factors.flags.writeable = False
    return quantities, factors


def static_coefficients(
    fit: OutputsFit, units: tuple[str, ...], model: ErrorModel, products: tuple[str, ...]
) -> Derived:
    """Computes all reported quantities from [U; V] in SI. Raises ValueError if the relation between output coefficients and
    physical coefficients cannot be inverted."""
    quantities, factors = reported(units, model, products)
    return derived(quantities, partial(_in_units, factors), fit)


def _in_units(factors: Array, outputs: Array) -> Array:
    """Computes n sets of the reported quantities (q, n), in their units, from the coefficients `outputs` (r, n), which are [U; V]
    in SI. `factors`: array of shape (q,), SI value of the unit of each quantity."""
    physical = flexure_gyro.physical_coefficients(outputs.reshape(2, -1, outputs.shape[1]))
    return np.asarray(np.concatenate([physical, outputs]) / factors[:, None])


def _two(outputs: tuple[str, ...]) -> tuple[str, ...]:
    if len(outputs) != 2 or outputs[0] == outputs[1]:
        raise EstimationError(f"a flexure gyro has two outputs, x and y, but `outputs` names {', '.join(outputs)}")
    return outputs


def _extra(
    observations: Observations,
    design: PositionsDesign,
    fit: OutputsFit,
    parameters: FlexureGyroStaticParameters,
) -> dict[str, object]:
    """Returns data in SI for another estimate that compensates with these coefficients: the coefficients, their covariance for each
    kind of uncertainty, the design matrix, and the times and noise of the observations. The bias instability is 0.0 if the weights
    do not include it."""
    flicker = {effect.quantity.name: effect.quantity.standard_uncertainty for effect in fit.effects}
    return {
        "outputs": list(parameters.outputs),
        "terms": list(design.model.names),
        "coefficients": fit.coefficients.tolist(),
        "covariance": {basis: fit.covariance(basis).tolist() for basis in BASES if fit.available(basis)},
        "matrix": design.matrix.tolist(),
        "gains": fit.gains.tolist(),
        "sigma": [noise.sigma.tolist() for noise in fit.noises],
        "start": observations.start.tolist(),
        "end": observations.end.tolist(),
        "bias_instability": [flicker.get(Aspect.BIAS_INSTABILITY.of(name), 0.0) for name in parameters.outputs],
        "drift_span": parameters.drift_span.value,
    }


_GEOMETRY = (
    said("Torquer scale factor, {axis}", axis="x"),
    said("Torquer scale factor, {axis}", axis="y"),
    said("Angle of the torquer's x axis to the case's x axis, ε"),
    said("Angle of the torquer's y axis to the case's y axis, ξ"),
)


def descriptions(products: tuple[str, ...] = ()) -> tuple[Said, ...]:
    """Returns the descriptions of the coefficients, in the order of `flexure_gyro.physical_names` and then of
    `flexure_gyro.output_names`."""
    of_drifts = (_drift(axis, rate, kind) for axis, rate in (("X", "Y"), ("Y", "X")) for kind in drifts(products))
    of_outputs = (
        said("Coefficient of the term {term} in the model of the torquer current i_{axis}", term=term, axis=axis)
        for axis in "xy"
        for term in flexure_gyro.static_model(products).names
    )
    return (*_GEOMETRY, *of_drifts, *of_outputs)


def _drift(axis: str, rate: str, kind: str) -> Said:
    """Returns the description of a drift coefficient. `kind`: `F`, or the letters of the axes whose accelerations cause the drift."""
    if kind == "F":
        return said(
            "Part of the drift D({drift}) that is independent of acceleration; D({drift}) adds to the rate ω_{rate}",
            drift=axis,
            rate=rate,
        )
    first, *second = tuple(kind.lower())
    if second:
        return said(
            "Part of the drift D({drift}) that is proportional to the product of the accelerations along {first} and {second}; "
            "D({drift}) adds to the rate ω_{rate}",
            drift=axis,
            first=first,
            second=second[0],
            rate=rate,
        )
    return said(
        "Part of the drift D({drift}) that is proportional to the acceleration along {axis}; D({drift}) adds to the rate ω_{rate}",
        drift=axis,
        axis=first,
        rate=rate,
    )


def information(design: PositionsDesign) -> tuple[dict[str, object], Said]:
    """Returns the values `determinant` and `condition` of a set of positions, and a sentence that states them. The values serve to
    compare sets of positions. For these values, rates are in units of the Earth rate, and accelerations in units of g."""
    sight = rank.look(design.matrix / design.magnitudes)
    determinant, condition = sight.determinant, sight.condition
    note = said(
        "Information matrix of the {positions} positions (rates in units of the Earth rate, accelerations in g): "
        "determinant {determinant:.6g}; condition number of the design matrix {condition:.3g}.",
        positions=len(design.matrix),
        determinant=determinant,
        condition=condition,
    )
    return {"determinant": determinant, "condition": condition}, note
