"""`planrunner design` for the rates of a plan, if an estimate uses spinning segments from one sweep."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.estimators.interface import EstimationError

if TYPE_CHECKING:
    from planrunner.reporting.rates_page import RatesContext
    from planrunner.tasks.design_rates import RateStudy


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rates",
        action="store_true",
        help="design the rates of a sweep (default: if an estimate fits a line over rates)",
    )
    parser.add_argument(
        "--line-only",
        action="store_true",
        help="rates: design for the straight line alone, without asymmetry and nonlinearity",
    )
    parser.add_argument("--drop-lowest", action="store_true", help="rates: the design may omit the lowest planned rate")


def study(args: argparse.Namespace, seconds: float | None, progress: Callable[[str, float], None] | None) -> RateStudy:
    from planrunner.tasks.design_rates import RateOptions, design_rates

    if args.criterion not in ("D", "A"):
        raise EstimationError(f"rates are designed by D or A, not by {args.criterion}")
    options = RateOptions(args.estimate, args.criterion, args.line_only, not args.drop_lowest, seconds)
    return design_rates(Path(args.plan), options, args.bench)


def context(study: RateStudy) -> RatesContext:
    from planrunner.reporting.context import site_facts
    from planrunner.reporting.rates_page import RatesContext, ShownRates

    checked = study.checked
    assert checked.plan is not None and checked.bench is not None and checked.models is not None
    return RatesContext(
        checked.plan.title,
        study.estimate,
        study.output,
        study.terms,
        study.options.criterion,
        study.options.time,
        study.repeats,
        {
            name: ShownRates(
                one.rates, one.dwells, one.efficiency, one.per_hour, one.variance, one.predicted, one.total
            )
            for name, one in study.sets.items()
        },
        study.course,
        study.excess,
        {"Plan": checked.file, "Bench": checked.bench.name, **site_facts(checked.models.site)},
    )
