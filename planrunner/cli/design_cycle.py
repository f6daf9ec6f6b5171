"""`planrunner design` for a plan with a segment that executes a cycle of turns and stops."""

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
        help="design this segment's cycle of turns and stops (default: if no estimate has positions that can be designed)",
    )
    parser.add_argument(
        "--order",
        choices=("free", "same"),
        default="free",
        help="cycle that is written into the plan: with a free order of stops, or with the same order (default: free)",
    )


def study(args: argparse.Namespace, seconds: float | None, progress: Callable[[str, float], None] | None) -> CycleStudy:
    from planrunner.tasks.design_cycles import CycleOptions, design_cycle

    if seconds is not None:
        raise EstimationError("--time distributes dwell times; the length of a cycle follows from its turns and stops")
    return design_cycle(Path(args.plan), CycleOptions(args.segment, args.order), args.bench)


def missing(study: CycleStudy) -> str:
    """The reason why there is no plan to write."""
    reason = study.reasons.get(study.chosen, "none was found")
    return f"no cycle with the {study.chosen} of stops can be written: {reason}"


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
