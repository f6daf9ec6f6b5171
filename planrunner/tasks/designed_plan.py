"""The plan proposed by a design study: the expected results of its estimates, its text, and writing it to a file once it passes its
checks."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base.findings import Findings
from planrunner.bench.scheduling import build_schedule
from planrunner.estimators.analysis import design_of
from planrunner.estimators.interface import Design, EstimationError
from planrunner.plan import source
from planrunner.plan.expand import expand
from planrunner.plan.orientation import Orientation, in_words
from planrunner.plan.rewriting import RewriteError, with_dwells, with_orientations
from planrunner.plan.schedule import Schedule
from planrunner.tasks.check import Checked, Document, check_plan

TextPlace = tuple[int, int]
"""(line, column) of what is changed in the plan."""


class PlanProposal(Protocol):
    """text: the proposed plan; checked: the original plan."""

    @property
    def text(self) -> str: ...
    @property
    def checked(self) -> Checked: ...


def write_plan(study: PlanProposal, path: Path, bench: str | None = None) -> Checked:
    """Writes the designed plan once it passes its checks. Raises `InputError` with the findings, and `EstimationError` if it would
    overwrite the original plan."""
    if path.exists() and path.samefile(study.checked.file):
        raise EstimationError(f"{path} is the plan itself: write to another file")
    data = study.text.encode()
    checked = check_plan(Document(data, str(path)), bench)
    checked.sound()
    aside = path.with_name(f".{path.name}.tmp")
    try:
        aside.write_bytes(data)
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)
    return checked


def moved(checked: Checked, attitudes: Mapping[TextPlace, NDArray[np.float64]]) -> tuple[Schedule, dict[str, Design]]:
    """The plan with other orientations, attitudes (3, 3) by where they are stated: its schedule with real transition times, and what its
    estimates could learn. Raises `EstimationError` where the bench cannot do it."""
    assert checked.plan is not None and checked.models is not None and checked.models.sensor is not None
    new = {
        place: Orientation(in_words(attitude), tuple(map(tuple, attitude.tolist())))
        for place, attitude in attitudes.items()
    }
    stated = []
    for item in expand(checked.plan, Findings()):
        mark = item.marks.get("orientation")
        changed = new.get((mark.line, mark.column)) if mark else None
        stated.append(replace(item, state={**item.state, "orientation": changed}) if changed else item)
    log = Findings()
    schedule = build_schedule(stated, checked.models, log, checked.plan.mounting)
    if log.errors:
        raise EstimationError(f"the bench cannot do it: {log.errors[0].message}")
    designs: dict[str, Design] = {}
    for name, spec in checked.plan.estimates.items():
        with contextlib.suppress(EstimationError):  # an estimate that is not designed for may make no sense here
            design = design_of(
                name, spec, schedule.segments, checked.models.site, checked.models.sensor, designs, checked.setup
            )
            if design is not None:
                designs[name] = design
    return schedule, designs


def with_positions(checked: Checked, orientations: Mapping[TextPlace, str], dwells: Mapping[TextPlace, float]) -> str:
    """The plan's text with other orientations and, where they are given, dwells [s]. Raises `EstimationError`."""
    text = source.decode(checked.plan_bytes, checked.file)
    try:
        if dwells:
            return with_dwells(text, {place: f"{dwell:g} s" for place, dwell in dwells.items()}, orientations)
        return with_orientations(text, orientations) if orientations else text
    except RewriteError as error:
        raise EstimationError(f"{checked.file}: {error}") from None
