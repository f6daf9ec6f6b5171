"""Compares two or more sets of coefficients by the residuals that remain at verification positions after compensation
(CN100554884C, model G0).

With each set, the rates ω_Y and ω_X are computed from the outputs. The residuals of a set are the differences between these rates
and the components of the Earth rate. The measured ratio of the residual sums of squares is compared with the ratio expected from
the positions of the sets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.error_model import flexure_gyro
from planrunner.estimators import rank
from planrunner.estimators.flexure_gyro.compensation_influences import (
    recovery,
    residual_influences,
    sums_and_ratios,
)
from planrunner.estimators.flexure_gyro.compensation_prediction import (
    Prediction,
    expected_sums,
    noise_maps,
    predict_residuals,
)
from planrunner.estimators.flexure_gyro.flexure_gyro_static import static_matrix
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignBlock,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Foresight,
    UnfitDataError,
    Unpredicted,
)
from planrunner.estimators.tables import Cell, Plot, Role, Table, TableColumn
from planrunner.observation.correlated_errors import explained
from planrunner.observation.flicker import flicker_errors, mean_covariance
from planrunner.observation.observations import Observations, observe, within_segment_noise
from planrunner.plan.kinds import Number, Record, key
from planrunner.plan.units import unit
from planrunner.uncertainty.derivatives import jacobian
from planrunner.uncertainty.influences import Influence
from planrunner.uncertainty.monte_carlo import square_root

AXES = ("ω_Y", "ω_X")
_DEG_H = unit("deg/h").factor
_NO_SET = "'{}' is not a set of the twelve static coefficients: `uses` names flexure_gyro_static estimates without product terms"
_SUMS = "Ratios of the residual sums of squares, measured and expected"
_CLAIM = said(
    "The publication that describes this method compares the residual sums of squares: it claims that the sum with "
    "the traditional positions is 4 to 8 times the sum with the optimal positions. The expected ratios given here "
    "assume equal noise in all positions. In single experiments with few verification positions, the ratio can "
    "differ greatly from the expected one."
)


class CompensationResidualParameters(Record):
    """Declares the plan keys of the estimator `compensation_residual`."""

    trials: int = key(
        Number(1000, 1_000_000, integer=True),
        "Number of simulated experiments, which give the expected range of the ratio of the residual sums of squares.",
        20_000,
        default=20_000,
    )
    seed: int = key(Number(0, 2**31, integer=True), "Seed of the simulated experiments.", 1, default=1)


class CompensationResidual:
    """Implements the estimator `compensation_residual`."""

    summary = "Residuals in verification positions after compensation with each of two or more sets of coefficients"
    Parameters = CompensationResidualParameters

    def design(self, request: DesignRequest[CompensationResidualParameters]) -> Design:
        """Returns a design without coefficients. The predicted ratios are in the notes and in `extra`. Raises `EstimationError` if
        the plan is not suitable."""
        model = flexure_gyro.static_model()
        matrix = static_matrix(model, request.segments, request.site)
        sets: dict[str, tuple[Array, Array]] = {}
        for name, design in request.uses.items():
            if len(design.blocks) != 2 or design.blocks[0].terms != model.names:
                raise EstimationError(_NO_SET.format(name))
            block = design.blocks[0]
            if rank.look(block.matrix / block.magnitudes).rank < len(model.names):
                return Design(())
            sets[name] = block.matrix, np.array([_relative(own) for own in design.blocks])
        _several(sets)
        expected = dict(zip(sets, expected_sums(matrix, tuple(sets.values())), strict=True))
        first, *others = expected
        ratios = {_ratio(name, first)[0]: expected[name] / expected[first] for name in others}
        notes = [
            f"Expected ratio of the residual sums of squares, {name} over {first}: "
            f"{expected[name] / expected[first]:.3g}, with equal noise."
            for name in others
        ]
        return Design((), (*notes, _CLAIM), {"ratios": ratios})

    def foresee(self, request: DesignRequest[CompensationResidualParameters]) -> Foresight:
        """Gives the names of the coefficients. No values are predicted, because the sum of only a few squared residuals has a
        standard deviation about as large as its expected value. The notes give the expected ratio of the sums."""
        first, *others = request.uses
        why = "the noise of a few verification positions determines it"
        named = [*map(_sum, request.uses), *(_ratio(name, first) for name in others)]
        return Foresight(unpredicted=tuple(Unpredicted(name, text, why, words) for name, text, words in named))

    def estimate(self, request: EstimateRequest[CompensationResidualParameters]) -> Estimate:
        """Computes the residuals of each set in `uses`. Raises `EstimationError` if the plan or the data are not suitable."""
        for name, used in request.uses.items():
            if used.extra.get("terms") != list(flexure_gyro.static_model().names):
                raise EstimationError(_NO_SET.format(name))
        _several(request.uses)
        outputs = {tuple(used.extra["outputs"]) for used in request.uses.values()}
        if len(outputs) > 1:
            raise EstimationError("the sets in `uses` come from different outputs and cannot be compared")
        observations = observe(request.segments, outputs.pop(), request.sensor)
        segments = [recorded.segment for recorded in request.segments]
        matrix = static_matrix(flexure_gyro.static_model(), segments, request.site)
        recovered = {
            name: flexure_gyro.compensated_rates(
                np.array(used.extra["coefficients"]), observations.mean, matrix[:, 3:6]
            )
            for name, used in request.uses.items()
        }
        residuals = {name: (rates - matrix[:, 1:3]) / _DEG_H for name, rates in recovered.items()}
        sets = {name: np.array(used.extra["gains"]) for name, used in request.uses.items()}
        rates = {
            name: recovery(np.array(used.extra["coefficients"]), len(matrix), _DEG_H)
            for name, used in request.uses.items()
        }
        noise = noise_maps(matrix, sets, [square_root(one) for one in _covariances(request, observations)])
        stated = residual_influences(request, observations.units, matrix, observations.mean, _DEG_H)
        prediction = predict_residuals(
            {name: rates[name] @ own for name, own in noise.items()},
            dict(zip(sets, _stated_maps(_independent(stated), len(sets), 2 * len(matrix)), strict=True)),
            request.parameters.trials,
            request.parameters.seed,
        )
        found = _assemble(request, observations.labels, residuals, prediction)
        flat = np.concatenate([values.T.ravel() for values in residuals.values()])
        gradient = jacobian(lambda changed: sums_and_ratios(changed, len(residuals)), flat)
        return replace(found, influences=tuple(one.through(gradient) for one in stated))


def _independent(stated: Sequence[Influence]) -> list[Influence]:
    """Returns only those influences whose inputs were known before the experiment. Inputs that were derived from the residuals of a
    fit are left out."""
    return [one for one in stated if not one.quantity.from_residuals]


def _stated_maps(stated: Sequence[Influence], sets: int, residuals: int) -> Array:
    """Returns the changes of the residuals (sets, residuals, s) if each of the s inputs is wrong by its standard uncertainty."""
    columns = [one.sensitivities * one.quantity.standard_uncertainty for one in stated]
    return np.hstack([np.zeros((sets * residuals, 0)), *columns]).reshape(sets, residuals, -1)


def _several(sets: Sized) -> None:
    if len(sets) < 2:
        raise EstimationError(
            "compensation_residual compares two or more sets of coefficients: name them in `uses`, the reference first"
        )


def _relative(block: DesignBlock) -> Array:
    """Returns the noise of the n observations of a calibration, divided by its root mean square, shape (n,). Only ratios of the
    noise matter."""
    typical = float(np.sqrt(np.mean(block.sigma**2)))
    return block.sigma / typical if typical > 0 else np.ones_like(block.sigma)


def _covariances(request: EstimateRequest[CompensationResidualParameters], observations: Observations) -> Array:
    """Returns the covariances of all observations of each output, due to noise within the segments and to declared flicker, shape
    (2, N, N)."""
    told = [used.extra for used in request.uses.values()]
    start = np.concatenate([observations.start, *(one["start"] for one in told)])
    end = np.concatenate([observations.end, *(one["end"] for one in told)])
    span = max(one["drift_span"] for one in told)
    found = []
    for k in range(2):
        effects = flicker_errors(observations, request.setup.inputs, span)
        noise = within_segment_noise(observations, k, explained(effects, k))
        variance = np.concatenate([noise.sigma, *(one["sigma"][k] for one in told)]) ** 2
        covariance = np.diag(variance)
        if size := told[0]["bias_instability"][k]:
            covariance += size**2 * mean_covariance(start, end, span)
        found.append(covariance)
    return np.array(found)


def _assemble(
    request: EstimateRequest[CompensationResidualParameters],
    labels: Sequence[str],
    residuals: Mapping[str, Array],
    prediction: Prediction,
) -> Estimate:
    names = tuple(residuals)
    first = names[0]
    if not residuals[first].any():
        raise UnfitDataError(
            f"the residuals of '{first}' are exactly zero, so no ratio can be formed: check whether the recording is noiseless"
        )
    flat = np.concatenate([values.T.ravel() for values in residuals.values()])
    computed = sums_and_ratios(flat[:, None], len(names))[:, 0].tolist()
    sums, measured_ratios = (
        dict(zip(names, computed, strict=False)),
        dict(zip(names[1:], computed[len(names) :], strict=True)),
    )
    coefficients, covariance = [], []
    for name in names:
        spread = sums[name] * prediction.relative_spread[name]
        label, text, words = _sum(name)
        coefficients.append(Coefficient(label, sums[name], text, spread, description=words))
        covariance.append(spread**2)
    rows = []
    for name in names[1:]:
        (low, middle, high), spread = prediction.ratios[name], prediction.ratio_spread[name]
        measured = measured_ratios[name]
        label, text, words = _ratio(name, first)
        coefficients.append(Coefficient(label, measured, text, spread, description=words))
        covariance.append(spread**2)
        expected = prediction.expected[name] / prediction.expected[first]
        rows.append((said("{first} / {second}", first=name, second=first), measured, expected, middle, low, high))
    titles = (
        "measured",
        "ratio of expected sums",
        "expected median",
        "expected 5 % quantile",
        "expected 95 % quantile",
    )
    ratio_columns = (TableColumn("sets"), *(TableColumn(title, Role.VALUE) for title in titles))
    outside = [row[0] for row in rows if not row[4] <= row[1] <= row[5]]
    notes = [
        said(
            "The measured ratio of {pair} is outside its expected range, from the 5 % to the 95 % quantile; by "
            "chance alone this happens in one of ten experiments.",
            pair=pair,
        )
        for pair in outside
    ]
    return Estimate(
        request.name,
        "compensation_residual",
        tuple(coefficients),
        np.diag(covariance),
        headline=tuple(item.name for item in coefficients),
        settings={
            "reference estimate": first,
            "trials": request.parameters.trials,
            "seed": request.parameters.seed,
        },
        tables=(
            Table(_SUMS, ratio_columns, tuple(rows), terminal=True),
            _residual_table(labels, residuals),
        ),
        plots=(_residual_plot(labels, residuals),),
        notes=(
            said(
                "The standard uncertainties combine two parts. The experiment is simulated many times with noise and the "
                "declared bias instability: the first part is half the width of the central 68 % interval of the results. The second "
                "part comes from the other inputs that the bench file declares, propagated to first order. The expected range of a "
                "ratio includes both parts."
            ),
            _CLAIM,
            *notes,
        ),
        warnings=(),
        segments=tuple(labels),
    )


def _sum(name: str) -> tuple[str, str, Said]:
    """Returns name, unit and description of the residual sum of squares of one set of coefficients."""
    return f"RSS_{name}", "(deg/h)^2", said("Residual sum of squares with the coefficients of '{name}'", name=name)


def _ratio(name: str, first: str) -> tuple[str, str, Said]:
    """Returns name, unit and description of the ratio of the residual sums of squares of two sets of coefficients."""
    words = said(
        "Residual sum of squares with the coefficients of '{first}', divided by the residual sum of squares with the "
        "coefficients of '{second}'",
        first=name,
        second=first,
    )
    return f"ratio_{name}_to_{first}", "1", words


def _residual_table(labels: Sequence[str], residuals: Mapping[str, Array]) -> Table:
    columns = (
        TableColumn("position"),
        *(TableColumn(f"'{name}': {axis}", Role.VALUE, "deg/h") for name in residuals for axis in AXES),
    )
    rows: list[tuple[Cell, ...]] = [
        (label, *(float(v) for values in residuals.values() for v in values[k])) for k, label in enumerate(labels)
    ]
    sums = (float(np.sum(values[:, a] ** 2)) for values in residuals.values() for a in range(len(AXES)))
    return Table("Residuals after compensation", columns, (*rows, ("sum of squares [(deg/h)²]", *sums)))


def _residual_plot(labels: Sequence[str], residuals: Mapping[str, Array]) -> Plot:
    series = {
        f"{name} {axis}": tuple(map(float, values[:, a]))
        for name, values in residuals.items()
        for a, axis in enumerate(AXES)
    }
    return Plot("Residuals after compensation", "position", "residual [deg/h]", tuple(labels), series)
