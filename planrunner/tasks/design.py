"""Designs a plan on its bench: finds better positions, better rates or a better rotation cycle, depending on the plan.

study = design(Path("plans/x.yaml"), Asked())
study.tables, study.data       what was found
study.text                     the plan with the chosen design
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from planrunner.base.workers import ALONE, Workers
from planrunner.design.study import Asked, SearchProgress, Study, Subject
from planrunner.estimators.interface import EstimationError
from planrunner.plan.parameters import Given
from planrunner.reporting import cycle_study, positions_study, rates_study
from planrunner.reporting.context import site_facts
from planrunner.tasks.check import Checked, Document, check_plan
from planrunner.tasks.design_cycles import design_cycle, has_cycle_alone
from planrunner.tasks.design_positions import design_positions
from planrunner.tasks.design_rates import design_rates, has_rates_alone


def design(
    plan: Path | Document,
    asked: Asked,
    bench: str | None = None,
    progress: SearchProgress | None = None,
    workers: Workers = ALONE,
    parameters: Mapping[str, Given] = MappingProxyType({}),
) -> Study:
    """Makes the design study for the plan and the options. The study designs positions if an estimate uses segments at rest.
    `workers`: processes that share the search. `parameters`: values for parameters of the plan. Raises `InputError` with the
    findings about the plan, and `EstimationError` if there is nothing to design."""
    checked = check_plan(plan, bench=bench, parameters=parameters)
    if asked.segment is None and (asked.rates or has_rates_alone(checked, asked.estimate)):
        return rates_study.study(design_rates(checked, asked, bench, workers), _subject(checked))
    if asked.segment is not None or (asked.estimate is None and has_cycle_alone(checked)):
        return cycle_study.study(design_cycle(checked, asked, workers), _subject(checked))
    return positions_study.study(design_positions(checked, asked, progress, workers), _subject(checked))


def _subject(checked: Checked) -> Subject:
    assert checked.plan is not None and checked.bench is not None and checked.models is not None
    facts = {"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)}
    return Subject(checked.plan.title, facts, checked.file, checked.findings)


def write_plan(text: str, original: str, path: Path, bench: str | None = None) -> Checked:
    """Checks a designed plan and writes it to a file. `original`: file of the plan from which the designed plan was made. Raises
    `InputError` with the faults of the designed plan, and `EstimationError` if the designed plan would overwrite the original."""
    if path.exists() and path.samefile(original):
        raise EstimationError(f"{path} is the plan itself: write to another file")
    data = text.encode()
    checked = check_plan(Document(data, str(path)), bench)
    checked.sound()
    aside = path.with_name(f".{path.name}.tmp")
    try:
        aside.write_bytes(data)
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)
    return checked
