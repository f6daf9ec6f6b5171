"""`planrunner self-test`: tests this installation with reference data with known answers."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from planrunner.cli import exit_codes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the comparisons as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner.archive.provenance import versions
    from planrunner.tasks.self_test import validate

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
    from planrunner.estimators.interface import Role, Table, TableColumn
    from planrunner.reporting import terminal
    from planrunner.reporting.columns import alike

    figures = alike(Role.VALUE, "known answer", "found", "relative difference", "allowed")
    columns = (*alike(Role.LABEL, "case", "quantity"), *figures, TableColumn("verdict"))
    cells = tuple(
        (
            row.case,
            row.quantity,
            row.known,
            row.found,
            f"{row.difference:.1e}",
            f"{row.allowed:.0e}",
            "passed" if row.passed else "FAILED",
        )
        for row in rows
    )
    console = terminal.console()
    console.print(terminal.data_table(Table("Self-test", columns, cells)))
    console.print(", ".join(f"{name} {version}" for name, version in versions().items()))
    print(f"{sum(row.passed for row in rows)} of {len(rows)} comparisons passed")
    return exit_codes.DONE if passed else exit_codes.LIMIT_FAILED
