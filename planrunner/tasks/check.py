"""Checks the form, the meaning and the physics of a plan on a bench.

checked = check_plan(Path("plans/x.yaml"))
checked.findings       all findings, with file:line:column
checked.schedule       the planned steps, with times
checked.designs        the expected results of each estimate, with predicted uncertainties
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from datetime import date, datetime, time
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Finding, Findings, InputError, Mark, closest
from planrunner.bench.calibration import check_validity
from planrunner.bench.model import Bench, BenchModels, bench_of, benches_for, models, read_bench
from planrunner.bench.scheduling import build_schedule
from planrunner.design.identifiability import Identifiability, identify
from planrunner.estimators.foresight import design_of
from planrunner.estimators.interface import Coefficient, Design, EstimationError, Setup
from planrunner.estimators.limits import bounds
from planrunner.instruments.models import SensorModel
from planrunner.plan import source
from planrunner.plan.expand import StatedSegment, expand
from planrunner.plan.meaning import check_channels, check_meaning
from planrunner.plan.model import EstimateSpec, Limit, Plan, parse_plan
from planrunner.plan.parameters import Given, variant_name, with_parameters
from planrunner.plan.quantity import parse_symmetric
from planrunner.plan.schedule import Schedule
from planrunner.plan.units import unit
from planrunner.reporting.budgets import shown_unit
from planrunner.reporting.certificate_requirements import check_certificate
from planrunner.reporting.sandbox import available
from planrunner.uncertainty.stated_inputs import check_backed, check_vertical, stated_inputs

if TYPE_CHECKING:
    from planrunner.review.approval_files import KeptApprovals

# Belsley, Kuh & Welsch (1980): condition indices of scaled columns above 30 mean strong dependence between terms.
ILL_CONDITIONED = 30.0
HOPELESS = 1e6


@dataclass(slots=True)
class Checked:
    """Contains the result of checking a plan: the findings, and the plan and the bench as far as they could be read.
    `plan_bytes`, `bench_bytes`: the exact bytes that were read. The plan already contains the values that were given for its
    parameters. `approvals`: the approvals that the bench requires; None if it requires none or if the plan lacks them."""

    file: str
    findings: Findings
    parameters: Mapping[str, str] = field(default_factory=dict)
    plan: Plan | None = None
    bench: Bench | None = None
    models: BenchModels | None = None
    schedule: Schedule | None = None
    designs: dict[str, Design] = field(default_factory=dict)
    judged: dict[str, tuple[Identifiability, ...]] = field(default_factory=dict)
    plan_bytes: bytes = b""
    bench_bytes: bytes = b""
    approvals: KeptApprovals | None = None

    @property
    def name(self) -> str:
        """Returns the name of the plan in the archive."""
        return variant_name(Path(self.file).stem, self.parameters)

    @property
    def setup(self) -> Setup:
        """Returns the test set-up, as far as the plan and the bench state it."""
        if self.plan is None or self.models is None or self.bench is None:
            return Setup()
        return Setup(
            self.models.table,
            self.plan.mounting,
            stated_inputs(self.bench, self.models, self.plan.mounting),
            replayed=self.models.replays,
        )

    @property
    def ok(self) -> bool:
        return self.schedule is not None and not self.findings.errors

    @property
    def portable(self) -> bool:
        """Returns True if the check would give the same result on another computer today. Another computer has no signing key, and
        it may have other runs, another time, and fewer files. The result is therefore False if the bench signs its runs, has a
        check standard or requires approvals, or if the check found an error."""
        bench = self.bench
        if bench is None or not self.ok:
            return False
        return bench.signing is None and bench.check_standard is None and bench.approvals is None

    def sound(self) -> Sound:
        """Returns the plan with everything that is needed to run it. Raises `InputError` with the findings if there are errors."""
        if (
            self.findings.errors
            or self.plan is None
            or self.bench is None
            or self.models is None
            or self.schedule is None
        ):
            raise InputError(self.findings)
        assert self.models.sensor is not None  # a bench without a sensor is an error
        return Sound(
            self.file,
            self.findings,
            self.parameters,
            self.plan,
            self.bench,
            self.models,
            self.models.sensor,
            self.schedule,
            self.designs,
            self.setup,
            self.plan_bytes,
            self.bench_bytes,
            self.approvals,
        )


@dataclass(frozen=True, slots=True)
class Sound:
    """Contains a plan that has passed its checks; `findings` may contain warnings. `parameters`: the values that the user gave for
    parameters. `approvals`: the approvals that the bench requires; None if it requires none. A bench that requires approvals does
    not run a plan without them."""

    file: str
    findings: Findings
    parameters: Mapping[str, str]
    plan: Plan
    bench: Bench
    models: BenchModels
    sensor: SensorModel
    schedule: Schedule
    designs: Mapping[str, Design]
    setup: Setup
    plan_bytes: bytes
    bench_bytes: bytes
    approvals: KeptApprovals | None = None

    @property
    def name(self) -> str:
        """Returns the name of the plan in the archive."""
        return variant_name(Path(self.file).stem, self.parameters)


@dataclass(frozen=True, slots=True)
class Document:
    """Contains the bytes of a plan or bench file, and its name in findings."""

    data: bytes
    shown: str


def check_plan(
    plan_file: Path | Document,
    bench: str | Path | Document | None = None,
    today: date | None = None,
    parameters: Mapping[str, Given] = MappingProxyType({}),
) -> Checked:
    """Performs all checks of a plan before it runs. The function raises no error, whatever the files contain.

    `plan_file`: path of the plan file, or its contents as a `Document`. The bench file that a plan names is searched for in the
    folder of the plan file; for a `Document`, it is searched for in the folder that the document's name contains
    (`Document.shown`). Approvals are searched for only if `plan_file` is a path. They are searched for next to this file. A
    `Document` can therefore pass the checks, but it does not run on a bench that requires approvals. `bench`: the name of a shipped
    bench, a path relative to the working folder, or a `Document`; this bench replaces the bench in the plan. `today`: the day on
    which calibrations must be valid; by default, the current day. `parameters`: values for parameters of the plan. Findings about
    such a value state where the value was given.
    """
    file = plan_file.shown if isinstance(plan_file, Document) else str(plan_file)
    checked = Checked(file, Findings(), {name: given.value for name, given in parameters.items()})
    places: Mapping[str, Mark] = {}
    try:
        checked.plan_bytes = plan_file.data if isinstance(plan_file, Document) else source.read_bytes(plan_file)
        text = source.decode(checked.plan_bytes, checked.file)
        if parameters:
            varied = with_parameters(text, file, parameters)
            text, places, checked.plan_bytes = varied.text, varied.places, varied.text.encode()
    except InputError as error:
        checked.findings = Findings(list(error.findings))
        return checked
    plan, checked.findings = parse_plan(text, checked.file)
    if plan is not None:
        checked.plan = plan
        _check_meaning(checked, plan, plan_file, bench, today)
    if places:
        checked.findings = Findings([_where_given(finding, parameters, places) for finding in checked.findings.items])
    return checked


def _where_given(finding: Finding, parameters: Mapping[str, Given], places: Mapping[str, Mark]) -> Finding:
    """Moves a finding about the value of a parameter to the position at which the value was given."""
    for name, place in places.items():
        if place.covers(finding.mark):
            given = parameters[name]
            return replace(finding, mark=given.mark, message=f"{name} = {given.value}: {finding.message}")
    return finding


def _check_meaning(
    checked: Checked, plan: Plan, plan_file: Path | Document, bench: str | Path | Document | None, today: date | None
) -> None:
    log = checked.findings
    stated = expand(plan, log)
    reports = report_names()
    check_meaning(plan, stated, reports, log)
    if _find_bench(checked, plan, bench):
        named = plan.origin.parts("bench") if bench is None else ()
        with log.resting_on(*named):
            _check_physics(checked, plan, stated)
        if checked.bench is not None:
            with log.resting_on(*named, *plan.origin.parts("record")):
                check_certificate(plan, checked.bench, checked.schedule, reports, log)
            seconds = checked.schedule.total if checked.schedule else 0.0
            check_validity(checked.bench.calibrations(), today or date.today(), seconds, log)
            if checked.models is not None:
                check_backed(checked.bench, checked.models, log)
                check_vertical(checked.bench, checked.models, log)
            _check_signing(checked.bench, log, key_needed=isinstance(plan_file, Path))
            if isinstance(plan_file, Path):
                _check_approvals(checked, plan_file, plan, checked.bench, today)


def _check_signing(bench: Bench, log: Findings, *, key_needed: bool) -> None:
    if bench.signing is not None:
        from planrunner.tasks.bench_signature import check_signing

        check_signing(bench, log, key_needed=key_needed)


def _check_approvals(checked: Checked, plan_file: Path, plan: Plan, bench: Bench, today: date | None) -> None:
    """Checks the approvals of a plan that has no errors. Plans with errors are not checked, because they cannot run and because the
    correction of an error may change their meaning."""
    if bench.approvals is None or checked.findings.errors:
        return
    from planrunner.tasks.approvals import required_approvals

    moment = datetime.now() if today is None else datetime.combine(today, time(23, 59, 59))
    args = plan_file, checked.plan_bytes, plan, bench, moment.astimezone(), checked.findings
    checked.approvals = required_approvals(*args)


_OTHER_PAGES = ("show", "design", "diagnosis", "difference", "timetable")
"""Templates of pages that are not reports of a run."""


@cache
def report_names() -> tuple[str, ...]:
    """Returns the names of the reports that can be written for a run: the shipped templates except the templates in
    `_OTHER_PAGES`."""
    return tuple(name for name in available() if name.partition(".")[0] not in _OTHER_PAGES)


def _find_bench(checked: Checked, plan: Plan, bench: str | Path | Document | None) -> bool:
    try:
        if isinstance(bench, Document):
            found = bench_of(bench.data, bench.shown), bench.data, bench.shown
        elif isinstance(bench, Path):
            found = read_bench(str(bench), None)
        elif bench is not None:
            found = read_bench(bench, Path())
        else:
            found = read_bench(plan.bench, Path(checked.file).parent)
    except InputError as error:
        missing = all(finding.code in ("file-missing", "meaning-unknown-bench") for finding in error.findings)
        for finding in error.findings:
            mark = plan.at("bench") if missing and bench is None else finding.mark
            checked.findings.error(finding.code, mark, finding.message, finding.hint)
        return False
    checked.bench, checked.bench_bytes, _ = found
    checked.models = models(checked.bench)
    return True


def _check_physics(checked: Checked, plan: Plan, stated: list[StatedSegment]) -> None:
    log = checked.findings
    assert checked.models is not None
    _check_sensor(plan, checked.models, log)
    if not stated:
        return
    # A bench for another kind of sensor is the wrong bench; all other faults follow from that.
    with log.resting_on(*plan.sensor.origin.parts("kind"), *plan.origin.meant.get("defaults", ())):
        schedule = build_schedule([segment for segment in stated if segment.sound], checked.models, log, plan.mounting)
        if len(schedule.segments) == len(stated) and all(spec.sound for spec in plan.segments):
            checked.schedule = schedule
            if checked.models.sensor is not None:
                _check_estimates(checked, plan, log)


def _check_sensor(plan: Plan, known: BenchModels, log: Findings) -> None:
    sensor = known.sensor
    if sensor is None:
        log.error("meaning-no-sensor", plan.at("sensor"), "this bench has no sensor", "use another bench")
        return
    if sensor.kind != plan.sensor.kind:
        message = (
            f"the plan is for a sensor of kind '{plan.sensor.kind}', but the bench has one of kind '{sensor.kind}'"
        )
        names = benches_for(plan.sensor.kind)
        shipped = f", for example a shipped one: {', '.join(names)}" if names else ""
        hint = f"use a bench with such a sensor{shipped}"
        log.error("meaning-sensor-kind", plan.sensor.at("kind"), message, hint)
        return
    outputs = [output.name for output in sensor.outputs]
    for index, name in enumerate(plan.sensor.outputs):
        if name not in outputs:
            message = f"the sensor of this bench has no output '{name}'"
            log.error("meaning-sensor-output", plan.sensor.at(f"outputs[{index}]"), message, closest(name, outputs))


def _check_estimates(checked: Checked, plan: Plan, log: Findings) -> None:
    assert checked.schedule is not None and checked.models is not None and checked.models.sensor is not None
    setup = checked.setup
    outputs = None if checked.models.replays else [output.name for output in checked.models.sensor.outputs]
    shared = (*plan.origin.parts("segments"), *plan.origin.parts("defaults"), *plan.origin.parts("mounting"))
    parts: dict[str, tuple[Mark, ...]] = {}
    for name, spec in plan.estimates.items():
        used = [part for other in spec.uses for part in parts.get(other, ())]
        parts[name] = (spec.origin.mark, *used)
        with log.resting_on(*shared, *parts[name]):
            _check_estimate(name, spec, outputs, checked, setup, log)
    for limit in plan.limits:
        estimate = limit.quantity.partition(".")[0]
        with log.resting_on(limit.origin.mark, *shared, *parts.get(estimate, ())):
            _check_limit(limit, checked.designs, log)


def _check_estimate(
    name: str, spec: EstimateSpec, outputs: list[str] | None, checked: Checked, setup: Setup, log: Findings
) -> None:
    assert checked.schedule is not None and checked.models is not None and checked.models.sensor is not None
    before = log.raised
    check_channels(spec.parameters, outputs, log)
    if log.raised > before or any(other not in checked.designs for other in spec.uses):
        return
    try:
        design = design_of(
            name,
            spec,
            checked.schedule.segments,
            checked.models.site,
            checked.models.sensor,
            checked.designs,
            setup,
        )
    except EstimationError as error:
        at = spec.at(error.key) if error.key else spec.origin.mark
        log.error(
            "physics-estimate", at, f"'{name}': {error}", error.hint or "choose other segments or another estimator"
        )
        return
    if design is None:
        return
    checked.designs[name] = design
    for remark in design.remarks:
        add = log.error if remark.error else log.note if remark.note else log.warning
        add(remark.code, spec.at(remark.key), f"'{name}': {remark.message}", remark.hint)
    checked.judged[name] = identify(design)
    explained = any(remark.conditions for remark in design.remarks)
    with log.resting_on(spec.origin.mark):  # depends on what the estimator reports about the segments
        said = [one for one in checked.judged[name] if not (explained and one.sound and one.condition <= HOPELESS)]
        for alike in _alike(said):
            _report(name, alike, spec.at("segments"), log)


def _alike(judged: Sequence[Identifiability]) -> list[list[Identifiability]]:
    """Groups the outputs with equal findings; the outputs in each group keep their order."""
    groups: dict[tuple[object, ...], list[Identifiability]] = {}
    for one in judged:
        what = (one.rank, one.columns, f"{one.condition:.3g}", one.unidentifiable, one.explanation)
        groups.setdefault(what, []).append(one)
    return list(groups.values())


def _report(name: str, alike: Sequence[Identifiability], mark: Mark, log: Findings) -> None:
    """Adds one finding for a group of outputs, if the outputs have a fault that must be reported."""
    judged, names = alike[0], [one.output for one in alike]
    outputs = f"output {names[0]}" if len(names) == 1 else f"outputs {', '.join(names[:-1])} and {names[-1]}"
    if not judged.sound:
        terms = ", ".join(judged.unidentifiable)
        where = f"rank {judged.rank} of {judged.columns}, {outputs}"
        message = f"'{name}' cannot identify {terms} on the planned segments ({where}){_because(judged)}"
        log.error("physics-rank", mark, message, "add segments that separate these terms, or leave the terms out")
    elif judged.condition > ILL_CONDITIONED:
        where = f"condition {judged.condition:.3g}, {outputs}"
        message = f"'{name}' is ill-conditioned on the planned segments ({where}){_because(judged)}"
        add = log.error if judged.condition > HOPELESS else log.warning
        add("physics-condition", mark, message, "use segments whose states differ more")


def _because(judged: Identifiability) -> str:
    return f": {judged.explanation}" if judged.explanation else ""


def _check_limit(limit: Limit, designs: Mapping[str, Design], log: Findings) -> None:
    estimate, _, name = limit.quantity.partition(".")
    design = designs.get(estimate)
    if design is None or not design.known:
        return
    known = design.foreseen
    if name not in known:
        message = f"'{estimate}' has no coefficient '{name}'"
        log.error("meaning-unknown-quantity", limit.at("quantity"), message, closest(name, known))
        return
    item = known[name]
    for key, bound in (("within", limit.within), ("at_least", limit.at_least), ("at_most", limit.at_most)):
        if bound is None:
            continue
        try:
            value = parse_symmetric(bound) if isinstance(bound, str) else bound
        except ValueError:
            continue
        if value is not None and value.unit.dimension != unit(item.unit).dimension:
            _other_dimension(limit, key, value.unit.text, item.unit, log)
            return
    if limit.prior is not None and limit.prior.unit.dimension != unit(item.unit).dimension:
        _other_dimension(limit, "prior", f"the prior in {limit.prior.unit.text}", item.unit, log)
    if isinstance(item, Coefficient):
        _foresee(limit, item, log)


def _other_dimension(limit: Limit, key: str, given: str, wanted: str, log: Findings) -> None:
    what = "prior" if key == "prior" else "limit"
    if wanted == "1":
        message, hint = (
            f"{limit.quantity} is a pure number, so {given} cannot be compared with it",
            f"write the {what} without a unit",
        )
    else:
        message, hint = (
            f"{limit.quantity} is in {wanted}, so {given} cannot be compared with it",
            f"write the {what} in {wanted}",
        )
    log.error("meaning-dimension", limit.at(key), message, hint)


def _foresee(limit: Limit, coefficient: Coefficient, log: Findings) -> None:
    """Warns about a limit with a guard band if the interval between its bounds is so narrow, compared with the expected
    uncertainty, that no value can pass the limit."""
    if limit.rule != "guarded":
        return
    try:
        low, high = bounds(limit, coefficient)
    except EstimationError:
        return  # other checks of the plan report the fault
    # Infinitely many degrees of freedom; fewer only make intervals wider.
    band = 2 * limit.guard_band * coefficient.standard_uncertainty
    if band and math.erf((high - low) / band / math.sqrt(2)) <= limit.coverage:
        from statistics import NormalDist

        least = NormalDist().inv_cdf(0.5 + limit.coverage / 2) * coefficient.standard_uncertainty
        shown = f"±{least:.2g} {shown_unit(coefficient.unit)}".rstrip() + f" ({100 * limit.coverage:g} %)"
        message = (
            f"the expected uncertainty of {limit.quantity} is at least {shown}, so no item can pass this guarded limit"
        )
        log.warning(
            "physics-limit", limit.origin.mark, message, "dwell longer, choose better positions, or widen the limit"
        )
