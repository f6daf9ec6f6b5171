"""`planrunner design` of a plan whose segment goes through a cycle of turns and stops."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.estimators.interface import EstimationError

if TYPE_CHECKING:
    from planrunner.reporting.cycle_page import CycleContext
    from planrunner.tasks.design_cycles import CycleStudy


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--segment",
        metavar="LABEL",
        help="design this segment's cycle of turns and stops (default: where no estimate's positions can be designed)",
    )
    parser.add_argument(
        "--order",
        choices=("free", "same"),
        default="free",
        help="which cycle goes into the plan: with a free or with the same order of stops (default: free)",
    )


def study(args: argparse.Namespace, seconds: float | None, progress: Callable[[str, float], None] | None) -> CycleStudy:
    from planrunner.tasks.design_cycles import CycleOptions, design_cycle

    if seconds is not None:
        raise EstimationError("--time allots dwells; a cycle takes the time that its turns and stops take")
    return design_cycle(Path(args.plan), CycleOptions(args.segment, args.order), args.bench)


def missing(study: CycleStudy) -> str:
    """Why there is no plan to write."""
    reason = study.reasons.get(study.chosen, "none was found")
    return f"there is no cycle with the {study.chosen} of stops to write: {reason}"


def context(study: CycleStudy) -> CycleContext:
    from planrunner.reporting.context import site_facts
    from planrunner.reporting.cycle_page import CycleContext

    checked = study.checked
    assert checked.plan is not None and checked.bench is not None and checked.models is not None
    return CycleContext(
        checked.plan.title,
        study.segment.label,
        study.axis.name,
        study.cycles,
        study.searches,
        study.reasons,
        study.chosen,
        {"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)},
    )
