"""`planrunner diff`: shows how the meanings of two plans, benches or runs differ, and the consequences."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.findings import InputError
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_json, write_named

DIFFERENT = 1
"""Exit code if there is a difference, as in diff(1)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "before", metavar="A", type=Path, nargs="?", help="plan file, bench (a file or a shipped name) or run folder"
    )
    parser.add_argument("after", metavar="B", type=Path, nargs="?", help="the same kind, to compare with A")
    parser.add_argument("--bench", metavar="BENCH", help="compare two plans on this bench: a shipped name or a file")
    parser.add_argument(
        "--no-predictions",
        action="store_true",
        help="compare only the meaning, without the consequences (computing them takes as long as `check` of both plans)",
    )
    parser.add_argument(
        "--html", metavar="FILE", type=Path, help="write a page with both timelines and all changed orientations"
    )
    parser.add_argument("--markdown", action="store_true", help="print a comment for a review in Markdown")
    parser.add_argument("--json", action="store_true", help="print the difference as JSON")
    parser.add_argument(
        "--textconv",
        metavar="FILE",
        type=Path,
        help="instead of comparing: print the meaning of a plan or bench line by line, for `git diff`",
    )
    parser.epilog = "Exit codes: 0 no difference, 1 a difference, 2 the files cannot be compared."


def run(args: argparse.Namespace) -> int:
    if args.textconv is not None:
        return _textconv(args.textconv)
    if args.before is None or args.after is None:
        raise InputError.of_usage("two plans, benches or runs are needed", "write `planrunner diff A B`")
    from planrunner.reporting.difference_tables import difference_json, difference_tables, headline, notes
    from planrunner.tasks.diff import compare

    compared = compare(args.before, args.after, args.bench, foresee=not args.no_predictions)
    if args.html is not None:
        from planrunner.reporting.difference_page import render_difference

        write_named(args.html, render_difference(compared), args.json or args.markdown)
    if args.json:
        print_json(difference_json(compared))
    elif args.markdown:
        from planrunner.reporting.difference_page import difference_markdown

        print(difference_markdown(compared), end="")
    elif args.html is None:
        from planrunner.reporting import terminal

        print(headline(compared))
        terminal.print_tables(*difference_tables(compared))
        for line in notes(compared):
            print(line)
    return DIFFERENT if compared.different else exit_codes.DONE


def _textconv(path: Path) -> int:
    """Prints the meaning of a file, for `git diff`. If the file is not a valid plan or bench, prints its text instead, because git
    needs a text for every version."""
    from planrunner.plan import source
    from planrunner.tasks.diff import meaning_of_file

    try:
        for line in meaning_of_file(path).lines():
            print(line)
    except InputError as error:
        print(f"# this version has no meaning: {error.findings[0]}")
        print(source.read_text(path))
    return exit_codes.DONE
