"""Writes notes and warnings for the report about the two kinds of uncertainty, `residual` and `within_segment`. Also checks whether
the two kinds are consistent with each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import BATCHES
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import count_of
from planrunner.base.said import Said, counted, said
from planrunner.estimators.drift_fit import FEW, DoubtedDrift, SuspectedDrift
from planrunner.estimators.interface import DesignBlock, DesignRequest, EstimationError, Remark, UnfitDataError
from planrunner.estimators.open_flicker import no_flicker_declared
from planrunner.estimators.outlying_segments import LEAST_REDUNDANCY, Outlier, agreement
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.observation.drift import ClockJump, DriftCourse
from planrunner.observation.observations import SIGNIFICANCE, Weighting
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.influences import Aspect


@dataclass(frozen=True, slots=True)
class BasisComparison:
    """Compares the residuals of one output with its noise. `ratio`: the statistic F, which is the residual variance divided by the
    within-segment variance. `probability`: probability that noise alone gives an F at least this large."""

    output: str
    ratio: float
    probability: float

    @property
    def exceeds(self) -> bool:
        return self.probability < SIGNIFICANCE


def compare(fit: OutputsFit) -> tuple[BasisComparison, ...]:
    """Compares residuals and noise for each output that has residuals and a known noise."""
    from scipy.special import fdtrc

    return tuple(
        BasisComparison(output, float(ratio), float(fdtrc(fit.freedom, noise.degrees_of_freedom, ratio)))
        for output, ratio, noise in zip(fit.outputs, fit.ratios, fit.noises, strict=True)
        if fit.freedom and noise.known
    )


def require_basis(fit: OutputsFit, basis: str, name: str) -> None:
    """Checks that the fit can give the kind of uncertainty that the plan requests. Raises `EstimationError` if the plan requests
    uncertainties from residuals, but there are too few segments. Raises `UnfitDataError` if the plan requests uncertainties from
    the noise within segments, but the samples do not show this noise."""
    if fit.available(basis):
        return
    if basis == "residual":
        raise EstimationError(f"{name}: {no_residual(fit.coefficients.shape[1])}; {MORE_SEGMENTS}")
    raise UnfitDataError(
        f"{name}: the samples within the segments do not vary (or are too few), so the within-segment noise cannot give an "
        "uncertainty; write `uncertainty: residual` or give the output's resolution in the bench file"
    )


def planned_basis(request: DesignRequest[object], blocks: Sequence[DesignBlock], basis: str) -> tuple[Remark, ...]:
    """Makes the same checks as `require_basis`, but for planned segments. Returns a remark that is an error if there are only as
    many segments as coefficients, or if no segment has two samples. If there are fewer segments than coefficients, another check
    reports that the rank is deficient."""
    for block in blocks:
        n, p = block.matrix.shape
        if basis == "residual" and n == p:
            return (Remark("physics-basis", no_residual(p), MORE_SEGMENTS, "segments", error=True),)
    single = [one for one in request.segments if planned_samples(request, one) == 1]
    if basis == "within_segment" and blocks and len(single) == len(request.segments):
        message = "no segment has two samples, so the noise within the segments cannot give an uncertainty"
        hint = "dwell longer, or write `uncertainty: residual`"
        return (Remark("physics-basis", message, hint, error=True),)
    return ()


MORE_SEGMENTS = "add segments or write `uncertainty: within_segment`"


def no_residual(count: int) -> str:
    """Returns a message that there are only as many segments as coefficients."""
    return f"{count} segments for {count} coefficients leave no residuals from which an uncertainty could be estimated"


def few_samples(request: DesignRequest[object]) -> tuple[Remark, ...]:
    """Warns of segments that are too short for batch means. The noise within a segment is computed from the scatter of these means."""
    short = [(count, one.label) for one in request.segments if 0 < (count := planned_samples(request, one)) < BATCHES]
    if not short:
        return ()
    count, label = min(short, key=lambda one: one[0])
    others = f" (and {count_of(len(short) - 1, 'more segment')} with too few samples)" if len(short) > 1 else ""
    message = (
        f"'{label}' holds {count_of(count, 'sample')}{others}: the noise within a segment is estimated "
        "from the scatter of "
        f"{BATCHES} batches of samples"
    )
    return (Remark("physics-few-samples", message, f"dwell for at least {BATCHES} samples, or sample faster"),)


def planned_samples(request: DesignRequest[object], segment: Segment) -> int:
    """Returns the planned number of samples of a segment; 0 if the length of the segment is not known."""
    return max(1, round((segment.sample_rate or request.sensor.sample_rate) * segment.dwell)) if segment.dwell else 0


def unlike_outputs(fit: OutputsFit) -> Said | None:
    """Returns a warning if the variance factors of the outputs differ too much to be pooled; otherwise None."""
    from scipy.special import fdtrc

    factors = np.array([one.variance_factor for one in fit.fits])
    low, high = int(np.argmin(factors)), int(np.argmax(factors))
    if not fit.freedom or factors[low] == factors[high]:
        return None
    ratio = float(factors[high] / factors[low]) if factors[low] > 0 else np.inf
    if 2 * fdtrc(fit.freedom, fit.freedom, ratio) >= SIGNIFICANCE:
        return None
    return said(
        "Relative to the noise, the residuals of {first} are larger than the residuals of {second} (variance "
        "ratio {ratio:.3g}): write `pool_outputs: false`, so that the uncertainty of each output is based on "
        "its own residuals.",
        first=fit.outputs[high],
        second=fit.outputs[low],
        ratio=ratio,
    )


@dataclass(frozen=True, slots=True)
class FitNote:
    """A note about a fit. `output`: the output that the note names; empty if the note is about all outputs of the fit."""

    text: Said
    output: str = ""


@dataclass(frozen=True, slots=True)
class Judgement:
    """Contains the notes and warnings of a report about the chosen kind of uncertainty."""

    notes: tuple[FitNote, ...]
    warnings: tuple[Said, ...]

    @property
    def texts(self) -> tuple[Said, ...]:
        """Returns the texts of the notes, without the names of the outputs."""
        return tuple(note.text for note in self.notes)


def judge(fit: OutputsFit, basis: str, channels: Sequence[str] = ()) -> Judgement:
    """Returns the notes and warnings of the report about the chosen kind of uncertainty. `channels`: the channels whose flicker
    affects the outputs; by default these are the outputs themselves."""
    notes: list[FitNote] = []
    warnings: list[Said] = []
    if basis == "residual":
        pooled = counted(
            "Uncertainties are based on the residuals: {freedom} degree of freedom for each output, pooled over the "
            "outputs. The fewer degrees of freedom, the larger the coverage factors.",
            "Uncertainties are based on the residuals: {freedom} degrees of freedom for each output, pooled over the "
            "outputs. The fewer degrees of freedom, the larger the coverage factors.",
            count=fit.freedom,
            freedom=fit.freedom,
        )
        apart = counted(
            "Uncertainties are based on the residuals: {freedom} degree of freedom for each output. The fewer degrees of "
            "freedom, the larger the coverage factors.",
            "Uncertainties are based on the residuals: {freedom} degrees of freedom for each output. The fewer degrees of "
            "freedom, the larger the coverage factors.",
            count=fit.freedom,
            freedom=fit.freedom,
        )
        notes.append(FitNote(pooled if fit.pooled else apart))
        notes += _too_small(fit)
        if fit.pooled and (different := unlike_outputs(fit)):
            warnings.append(different)
    else:
        within = said(
            "Uncertainties are based on the noise within the segments and on the stated inputs; other changes from "
            "segment to segment are not included."
        )
        notes.append(FitNote(within))
    unstated = {error.channel for error in fit.unstated}
    notes += map(FitNote, _weights(fit, [name for name in channels or fit.outputs if name not in unstated]))
    for found in compare(fit):
        if found.exceeds:
            warnings.append(_exceeding(found, basis))
            continue
        by_chance = said(
            "{output}: the residual variance is {ratio:.3g} times the variance expected from the noise within the segments and "
            "the declared inputs. The probability that a ratio at least this large occurs by chance is {chance:.2g}.",
            output=found.output,
            ratio=found.ratio,
            chance=found.probability,
        )
        notes.append(FitNote(by_chance, found.output))
    for output, noise, width, own in zip(fit.outputs, fit.noises, fit.between, fit.spreads, strict=True):
        if width:
            scattering = said(
                "{output}: the noise within the segments does not explain the residuals. Therefore, the weights "
                "include scatter between segments with a standard deviation of {width:.3g} (in the unit of the "
                "output).",
                output=output,
                width=width,
            )
            notes.append(FitNote(scattering, output))
        elif noise.weighting is Weighting.INDIVIDUAL and not np.ptp(own):
            alike = said(
                "{output}: the noise differs between segments, but the plan gives all segments the same weight.",
                output=output,
            )
            notes.append(FitNote(alike, output))
        elif noise.weighting is Weighting.INDIVIDUAL:
            weighted = said(
                "{output}: the noise differs between segments, so each segment is weighted by its own noise.",
                output=output,
            )
            notes.append(FitNote(weighted, output))
    drifted = drift_words(fit, basis)
    notes += map(FitNote, drifted.notes)
    warnings += drifted.warnings
    agreeing = agreement(fit, basis)
    warnings += [_outlying(fit, one, basis) for one in agreeing.outliers]
    if agreeing.unchecked:
        hardly = counted(
            "An error in the segment {segments} would hardly be noticed, because less than {share:.0f} % of the error "
            "appears in the residuals. Repeat this segment to confirm it.",
            "An error in one of the segments {segments} would hardly be noticed, because less than {share:.0f} % of "
            "the error appears in the residuals. Repeat these segments to confirm them.",
            count=len(agreeing.unchecked),
            segments=agreeing.unchecked,
            share=100 * LEAST_REDUNDANCY,
        )
        notes.append(FitNote(hardly))
    return Judgement(tuple(notes), tuple(warnings))


@dataclass(frozen=True, slots=True)
class DriftWords:
    """Contains the notes and warnings of a report about a drift during the test."""

    notes: tuple[Said, ...] = ()
    warnings: tuple[Said, ...] = ()


def drift_words(fit: OutputsFit, basis: str) -> DriftWords:
    """Returns the notes and warnings about a drift. Notes are about a drift that the plan requests, or that the segments cannot
    show. Warnings are about a drift that the segments show, or do not exclude."""
    drift = fit.drift
    if not drift.courses:
        suspected = tuple(_suspected(fit, one, basis) for one in drift.suspected)
        suspected += () if drift.jumped is None else (_jumped(fit, drift.jumped),)
        named = {one.course.name for one in drift.suspected}
        doubted = tuple(_doubted(fit, one) for one in drift.doubted if one.course.name not in named)
        if drift.rivals and drift.nonlinear is not None:
            included = tuple(_included(fit, one) for one in drift.doubted)
            return DriftWords(included, (_rivalled(fit, drift.rivals, drift.nonlinear),))
        if drift.judged:
            return DriftWords(warnings=(*suspected, *doubted))
        hidden = said(
            "{outputs}: a drift during the test cannot be distinguished from the coefficients or from scatter, so "
            "no drift is fitted. Repeat the first segment at the end, or add segments.",
            outputs=fit.outputs,
        )
        return DriftWords((hidden,), suspected)
    names = _named(drift.courses)
    if drift.without is None or drift.explained is None:
        planned = said(
            "{outputs}: a drift ({drifts}) is fitted together with the coefficients. The coefficients are averages over the "
            "recorded time of the test.",
            outputs=fit.outputs,
            drifts=names,
        )
        return DriftWords(notes=(planned,))
    spreads = np.sqrt(np.diag(fit.covariance(basis))).reshape(fit.coefficients.shape)
    shares = _shares(fit, drift.explained)
    seen = said(
        "The outputs seem to drift during the test: a drift ({drifts}) explains {shares} of the scatter about the "
        "model. A term that is missing from the model can also look like a drift, if its effect increases or "
        "decreases in the order of the segments. The drift is fitted together with the coefficients. Without the "
        "drift, a coefficient would change by {moved:.2g} standard uncertainties. The coefficients are averages "
        "over the recorded time of the test. Write `drift: {written}` to confirm the drift, or `drift: none` to "
        "exclude it.",
        drifts=names,
        shares=shares,
        moved=float(np.max(np.abs(fit.coefficients - drift.without) / spreads)),
        written=_written(drift.courses),
    )
    bent = () if drift.nonlinear is None else (_bent(fit, drift.courses, drift.nonlinear),)
    if fit.freedom >= FEW:
        return DriftWords(warnings=(seen, *bent))
    doubtful = counted(
        "{warning} Only {count} degree of freedom is left, so errors of the positions could look like a drift: "
        "repeat the first segment at the end.",
        "{warning} Only {count} degrees of freedom are left, so errors of the positions could look like a "
        "drift: repeat the first segment at the end.",
        count=fit.freedom,
        warning=seen,
    )
    return DriftWords(warnings=(doubtful, *bent))


def _jumped(fit: OutputsFit, found: ClockJump) -> Said:
    """Returns a warning about a jump of the recording's clock that hides a drift."""
    values: dict[str, Said | str | float | tuple[str, ...]] = {
        "outputs": fit.outputs,
        "seconds": found.seconds,
        "segment": found.label,
    }
    if found.within:
        return said(
            "{outputs}: the times in segment '{segment}' contain a gap of {seconds:.3g} s. If the clock of the recording jumped "
            "there by this time, a steady drift during the test explains the residuals; with the recorded times, it does "
            "not. Correct the times, or record again without a change of the clock.",
            **values,
        )
    return said(
        "{outputs}: the pause before segment '{segment}' differs from the other pauses by {seconds:.3g} s. If the clock of the "
        "recording jumped there by this time, a steady drift during the test explains the residuals; with the recorded times, it "
        "does not. Correct the times, or record again without a change of the clock.",
        **values,
    )


def _named(courses: Sequence[DriftCourse]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(course.name for course in courses))


def _shares(fit: OutputsFit, shares: NDArray[np.float64]) -> tuple[Said, ...]:
    """Returns, for each output, a text with the percentage of the scatter that a drift or a nonlinearity explains. `shares`: array
    of shape (m,), the explained fraction of the scatter of each output, from 0 to 1."""
    return tuple(
        said("{share:.3g} % ({output})", share=100 * float(share), output=output)
        for output, share in zip(fit.outputs, shares, strict=True)
    )


def _doubted(fit: OutputsFit, found: DoubtedDrift) -> Said:
    """Returns a warning about a drift that is included in the uncertainties, although it is not fitted."""
    return said(
        "{outputs}: the segments neither show nor exclude a drift ({drift}; probability by chance: {chance:.2g}). "
        "The drift is not fitted, but the uncertainties include the change of the coefficients that it would cause. "
        "To find out whether there is a drift, repeat the first segment at the end. Write `drift: none` if there is "
        "no drift.",
        outputs=fit.outputs,
        drift=found.course.name,
        chance=found.probability,
    )


def _included(fit: OutputsFit, found: DoubtedDrift) -> Said:
    """Returns a note about a drift that was not fitted, because a nonlinearity may explain the residuals instead. The drift is
    therefore included in the uncertainties."""
    return said(
        "{outputs}: the uncertainties include the change of the coefficients that the drift ({drift}) would cause.",
        outputs=fit.outputs,
        drift=found.course.name,
    )


def _rivalled(fit: OutputsFit, courses: Sequence[DriftCourse], nonlinear: NDArray[np.float64]) -> Said:
    """Returns a warning about residuals that come either from a drift or from a nonlinearity."""
    return said(
        "The residuals look like a drift during the test ({drifts}), but a nonlinearity of the outputs also "
        "explains them: the square of the output explains {shares} of the scatter about the model. Neither is "
        "fitted, so the coefficients may contain a part of the drift or of the nonlinearity. To find out which "
        "explanation is true, repeat the first segment at the end. Write `drift: {written}` to fit the drift, "
        "`drift: none` to exclude it, or estimate the nonlinearity with {estimator}.",
        drifts=_named(courses),
        shares=_shares(fit, nonlinear),
        written=_written(courses),
        estimator="error_model",
    )


def _bent(fit: OutputsFit, courses: Sequence[DriftCourse], nonlinear: NDArray[np.float64]) -> Said:
    """Returns a warning about a drift that is fitted because other outputs show it, although the residuals of these outputs come
    either from this drift or from a nonlinearity."""
    return said(
        "{outputs}: the drift ({drifts}) is fitted because other outputs of the sensor show it. A nonlinearity of these outputs "
        "also explains the residuals without the drift: the square of the output explains {shares} of the scatter about the model. "
        "The coefficients may contain a part of the nonlinearity. To find out which explanation is true, repeat the first segment "
        "at the end, or estimate the nonlinearity with {estimator}.",
        outputs=fit.outputs,
        drifts=_named(courses),
        shares=_shares(fit, nonlinear),
        estimator="error_model",
    )


def _suspected(fit: OutputsFit, found: SuspectedDrift, basis: str) -> Said:
    """Returns a warning about a drift that is not fitted, although the data do not exclude a drift large enough to matter."""
    output, name = fit.outputs[found.output], found.course.name
    if found.course.changed:
        return said(
            "The temperature changed by {change:.3g} K during the test. In this order of the segments, a drift "
            "with temperature is hard to distinguish from {coefficient} of {output}: {size}. The data neither "
            "show nor exclude such a "
            "drift, {consequence}. Write `drift: temperature` to include it, or `drift: none` if the outputs do "
            "not depend on the temperature. To distinguish the two, keep the temperature steadier, or record "
            "the segments a second time in the opposite order.",
            change=found.course.changed,
            coefficient=found.name,
            output=output,
            size=_size(found),
            consequence=_consequence(fit, found),
        )
    k, p = found.output, fit.matrix.shape[1]
    spread = float(np.sqrt(np.diag(fit.covariance(basis))[k * p + found.term]))
    return said(
        "The outputs may drift during the test. If a drift ({drift}) were fitted together with the coefficients, "
        "{coefficient} of {output} would change by {change:.2g} standard uncertainties (probability by chance: "
        "{chance:.2g}). This evidence is too weak to fit the drift, {consequence}. Write `drift: {drift}` to fit "
        "the drift, or `drift: none` to exclude it. To find out whether there is a drift, repeat the first segment "
        "at the end.",
        drift=name,
        coefficient=found.name,
        output=output,
        change=abs(found.change) / spread,
        chance=found.probability,
        consequence=_consequence(fit, found),
    )


def _consequence(fit: OutputsFit, found: SuspectedDrift) -> Said:
    """Returns a clause that states whether the uncertainties include a drift that was not fitted."""
    if fit.drift.doubts(found.course):
        return said("but the uncertainties include the change that the drift would cause")
    return said("so no uncertainty includes the drift")


def _size(found: SuspectedDrift) -> Said:
    """Returns a clause that states how the uncertainty of the coefficient would change if the drift were fitted."""
    if not np.isfinite(found.growth):
        return said("no fit to these segments can separate the two")
    return said(
        "if the drift were fitted together with the coefficients, the standard uncertainty would be {growth:.2g} "
        "times as large",
        growth=found.growth,
    )


def _written(courses: Sequence[DriftCourse]) -> str:
    """Returns the value of the plan key `drift` that requests these drift functions."""
    highest = max((course for course in courses if course.order), key=lambda one: one.order, default=None)
    words = [course.name for course in courses if course is highest or not course.order]
    return words[0] if len(words) == 1 else f"[{', '.join(words)}]"


def _too_small(fit: OutputsFit) -> list[FitNote]:
    """Returns notes about outputs whose residuals are significantly smaller than the noise within the segments."""
    return [
        FitNote(
            said(
                "{output}: the residuals are significantly smaller than the noise within the segments permits. Either they are "
                "small by chance, or the segments have a change in common that looks like noise. Therefore, this noise "
                "determines the uncertainties of this output, with {freedom:.4g} degrees of freedom.",
                output=output,
                freedom=noise.degrees_of_freedom,
            ),
            output,
        )
        for output, noise, small in zip(fit.outputs, fit.noises, fit.by_noise, strict=True)
        if small
    ]


def _exceeding(found: BasisComparison, basis: str) -> Said:
    """Returns a warning that the residuals are larger than the noise explains."""
    values: dict[str, str | float] = {"output": found.output, "ratio": found.ratio, "chance": found.probability}
    if basis == "within_segment":
        return said(
            "{output}: the residual variance is {ratio:.3g} times the variance expected from the noise within the "
            "segments and the declared inputs (probability by chance: {chance:.2g}). Either something changes from "
            "segment to segment (positions or a slow drift), or the model is incomplete. The within-segment "
            "uncertainties are too small.",
            **values,
        )
    return said(
        "{output}: the residual variance is {ratio:.3g} times the variance expected from the noise within the "
        "segments and the declared inputs (probability by chance: {chance:.2g}). Either something changes from "
        "segment to segment (positions or a slow drift), or the model is incomplete. Only uncertainties that "
        "are based on the residuals are valid.",
        **values,
    )


def _outlying(fit: OutputsFit, found: Outlier, basis: str) -> Said:
    k, p = fit.outputs.index(found.output), fit.matrix.shape[1]
    spreads = np.sqrt(np.diag(fit.covariance(basis))[k * p : (k + 1) * p])
    moved = float(np.max(np.abs(found.changes) / spreads))
    return said(
        "Segment '{segment}' does not fit the other segments: the mean of {output} differs by {error:.3g} {unit} "
        "from the value that they predict ({deviations:.3g} standard deviations; probability by chance: "
        "{chance:.2g}). Without this segment, a coefficient changes by {change:.2g} standard uncertainties. Check "
        "the label, the planned state and the data of the segment.",
        segment=found.label,
        output=found.output,
        error=found.error,
        unit=fit.units[k],
        deviations=found.deviations,
        chance=found.probability,
        change=moved,
    )


def _weights(fit: OutputsFit, channels: Sequence[str]) -> list[Said]:
    """Returns notes about effects that the weights of the fit include in addition to the noise, and about outputs without declared
    flicker."""
    notes = []
    if fit.effects:
        names = dict.fromkeys(effect.quantity.name for effect in fit.effects)
        notes.append(
            said(
                "In addition to the noise, these inputs are included in the weights of the fit: {inputs}.",
                inputs=tuple(names),
            )
        )
    flickering = {effect.quantity.name for effect in (*fit.effects, *fit.unweighted)}
    silent = [name for name in channels if Aspect.BIAS_INSTABILITY.of(name) not in flickering]
    if silent:
        notes.append(no_flicker_declared(silent))
    return notes
