"""`planrunner design` for the positions of a plan, if an estimate uses segments at rest."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.estimators.interface import EstimationError

if TYPE_CHECKING:
    from planrunner.reporting.design_page import DesignContext
    from planrunner.tasks.design_positions import Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--output", metavar="NAME", help="design for this output, where the outputs have different terms"
    )
    parser.add_argument(
        "--orientations",
        choices=("free", "cardinal", "planned"),
        default="free",
        help="set that is written into the plan (default: free)",
    )
    parser.add_argument("--restarts", type=int, default=8, help="seeded starts of the free search (default: 8)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default: 0)")


def study(args: argparse.Namespace, seconds: float | None, progress: Callable[[str, float], None] | None) -> Study:
    from planrunner.tasks.design_positions import PositionOptions, design_plan

    if args.restarts < 1 or args.seed < 0:
        raise EstimationError("--restarts must be at least 1 and --seed at least 0")
    options = PositionOptions(
        args.estimate, args.output, args.criterion, args.orientations, seconds, args.restarts, args.seed
    )
    return design_plan(Path(args.plan), options, args.bench, progress)


def context(study: Study) -> DesignContext:
    from planrunner.reporting.context import site_facts
    from planrunner.reporting.design_page import DesignContext, DesignedSet
    from planrunner.tasks.design_positions import residual_ratios

    checked = study.checked
    assert checked.plan is not None and checked.bench is not None and checked.models is not None
    sets = {}
    for name, one in study.sets.items():
        design = one.designs.get(study.sight.name)
        sets[name] = DesignedSet(
            tuple(place.label for place in study.places),
            one.texts,
            one.attitudes,
            one.merit,
            one.of_found,
            one.of_bound,
            one.of_cardinal,
            one.schedule.total,
            residual_ratios(study, name),
            design.predicted if design is not None else (),
        )
    claims = [
        note
        for name, design in study.sets["planned"].designs.items()
        if name != study.sight.name and not design.blocks
        for note in design.notes
    ]
    return DesignContext(
        checked.plan.title,
        study.sight.name,
        study.sight.others,
        study.sight.terms,
        study.options.criterion,
        study.options.orientations,
        sets,
        study.best,
        {name: one.merit for name, one in study.bounds.items()},
        {name: one.certificate for name, one in study.bounds.items()},
        study.search,
        study.dwells,
        study.dwell_gain,
        {"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)},
        tuple(claims),
        len(study.sight.fixed),
    )
