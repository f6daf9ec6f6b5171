"""Which basis of uncertainty the data can give, and what either says about the other: notes and warnings for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.estimators.interface import DesignBlock, EstimationError, Remark
from planrunner.estimators.observations import SIGNIFICANCE
from planrunner.estimators.outputs_fit import OutputsFit


@dataclass(frozen=True, slots=True)
class BasisComparison:
    """F = residual variance over within-segment variance of one output; probability: of an F this large if noise were all."""

    output: str
    ratio: float
    probability: float

    @property
    def exceeds(self) -> bool:
        return self.probability < SIGNIFICANCE


def compare(fit: OutputsFit) -> tuple[BasisComparison, ...]:
    """The two bases against each other, for the outputs that have both."""
    from scipy.special import fdtrc

    return tuple(
        BasisComparison(output, float(ratio), float(fdtrc(fit.freedom, noise.degrees_of_freedom, ratio)))
        for output, ratio, noise in zip(fit.outputs, fit.ratios, fit.noises, strict=True)
        if fit.freedom and noise.known
    )


def require_basis(fit: OutputsFit, basis: str, name: str) -> None:
    """Raises `EstimationError` when the plan asks for a basis that the data cannot give."""
    if fit.available(basis):
        return
    if basis == "residual":
        raise EstimationError(f"{name}: {no_residual(fit.coefficients.shape[1])}; {MORE_SEGMENTS}")
    raise EstimationError(
        f"{name}: the samples within the segments do not vary (or are too few), so there is no within-segment noise to take "
        "an uncertainty from; write `uncertainty: residual` or give the output's resolution in the bench file"
    )


def planned_basis(blocks: Sequence[DesignBlock], basis: str) -> tuple[Remark, ...]:
    """The same of planned segments: an error where they are only just as many as the coefficients. Fewer are an error of rank."""
    for block in blocks:
        n, p = block.matrix.shape
        if basis == "residual" and n == p:
            return (Remark("physics-basis", no_residual(p), MORE_SEGMENTS, "segments", error=True),)
    return ()


MORE_SEGMENTS = "add segments or write `uncertainty: within_segment`"


def no_residual(count: int) -> str:
    """That so many segments are only just as many as the coefficients."""
    return f"{count} segments for {count} coefficients leave no residual to take an uncertainty from"


def unlike_outputs(fit: OutputsFit) -> str:
    """A warning when the outputs' variance factors differ too much to be pooled; empty when they do not."""
    from scipy.special import fdtrc

    factors = np.array([one.variance_factor for one in fit.fits])
    low, high = int(np.argmin(factors)), int(np.argmax(factors))
    if not fit.freedom or factors[low] == factors[high]:
        return ""
    ratio = float(factors[high] / factors[low]) if factors[low] > 0 else np.inf
    if 2 * fdtrc(fit.freedom, fit.freedom, ratio) >= SIGNIFICANCE:
        return ""
    return (
        f"The residuals of {fit.outputs[high]} exceed its noise by more than those of {fit.outputs[low]} do (variance ratio {ratio:.3g}): "
        "write `pool_outputs: false` so that each output's uncertainty rests on its own residuals."
    )


def judge(fit: OutputsFit, basis: str, channels: Sequence[str] = ()) -> tuple[list[str], list[str]]:
    """Notes and warnings on the basis that was chosen, for the report. channels: whose flicker reaches the outputs; these without it."""
    notes, warnings = [], []
    if basis == "residual":
        together = ", pooled over the outputs" if fit.pooled else ""
        notes.append(
            f"Uncertainties rest on the residuals: {fit.freedom} degrees of freedom for each output{together}, "
            "so the coverage factors are large."
        )
        if fit.pooled and (different := unlike_outputs(fit)):
            warnings.append(different)
    else:
        notes.append(
            "Uncertainties rest on the noise within the segments and on what is stated; whatever else changes from segment to segment is "
            "not in them."
        )
    notes += _weights(fit, channels or fit.outputs)
    for found in compare(fit):
        text = (
            f"{found.output}: residual variance is {found.ratio:.3g} times that expected from the noise within the segments and what "
            "is stated beside it"
        )
        if found.exceeds:
            consequence = (
                "the within-segment uncertainties are too small"
                if basis == "within_segment"
                else "keep to the residual basis"
            )
            warnings.append(
                f"{text} (chance of that: {found.probability:.2g}). Something changes from segment to segment "
                f"(positions, slow drift, or the model is incomplete): {consequence}."
            )
        else:
            notes.append(f"{text}, which chance explains (probability {found.probability:.2g}).")
    for output, noise, width, own in zip(fit.outputs, fit.noises, fit.between, fit.spreads, strict=True):
        if width:
            notes.append(
                f"{output}: {width:.3g} (standard deviation, in the output's unit) is added between segments to their own noise for the "
                "weights, because that noise does not explain the residuals."
            )
        elif noise.weighting == "individual" and not np.ptp(own):
            notes.append(
                f"{output}: the noise differs between segments, but all have the same weight, as the plan says."
            )
        elif noise.weighting == "individual":
            notes.append(f"{output}: the noise differs between segments, so each is weighted by its own.")
    return notes, warnings


def _weights(fit: OutputsFit, channels: Sequence[str]) -> list[str]:
    """What is weighted beside the noise, and the outputs for which nobody said how large their flicker is."""
    notes = []
    if fit.effects:
        names = dict.fromkeys(effect.quantity.name for effect in fit.effects)
        notes.append(f"Weighted beside the noise: {', '.join(names)}.")
    flickering = {effect.quantity.name for effect in (*fit.effects, *fit.unweighted)}
    silent = [name for name in channels if f"bias instability {name}" not in flickering]
    if silent:
        notes.append(
            f"No bias instability is declared for {', '.join(silent)}: the intervals hold for noise that is white from segment to segment."
        )
    return notes
