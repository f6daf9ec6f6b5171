"""`planrunner self-test`: tests this installation with reference data whose correct results are known."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from planrunner.cli import exit_codes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the comparisons as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.archive.provenance import versions
    from planrunner.tasks.self_test import Comparison, validate

    with tempfile.TemporaryDirectory(prefix="planrunner-") as folder:
        rows = list(validate(Path(folder)))
    passed = all(row.passed for row in rows)
    if args.json:
        from dataclasses import asdict

        from planrunner.cli.printing import print_json

        print_json(
            {
                "passed": passed,
                "versions": versions(),
                "comparisons": [asdict(row) | {"passed": row.passed} for row in rows],
            }
        )
        return exit_codes.DONE if passed else exit_codes.LIMIT_FAILED
    from planrunner.estimators.tables import Role, Shown, TableColumn, table_of
    from planrunner.reporting import terminal

    columns: tuple[Shown[Comparison], ...] = (
        Shown(TableColumn("case"), lambda row: row.case),
        Shown(TableColumn("quantity"), lambda row: row.quantity),
        Shown(TableColumn("known answer", Role.VALUE), lambda row: row.known),
        Shown(TableColumn("found", Role.VALUE), lambda row: row.found),
        Shown(TableColumn("relative difference", Role.VALUE), lambda row: f"{row.difference:.1e}"),
        Shown(TableColumn("allowed", Role.VALUE), lambda row: f"{row.allowed:.0e}"),
        Shown(TableColumn("verdict"), lambda row: "passed" if row.passed else "FAILED"),
    )
    terminal.print_tables(table_of("Self-test", columns, rows))
    terminal.console().print(", ".join(f"{name} {version}" for name, version in versions().items()))
    print(f"{sum(row.passed for row in rows)} of {len(rows)} comparisons passed")
    return exit_codes.DONE if passed else exit_codes.LIMIT_FAILED
