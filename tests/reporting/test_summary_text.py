"""summary.md and the terminal's tables, against texts that were read and agreed upon."""

from __future__ import annotations

import io
from itertools import pairwise

import golden_files
import pytest
import reporting_example as example
from rich.console import RenderableType

from planrunner.estimators.tables import Role, Table, TableColumn
from planrunner.reporting import terminal
from planrunner.reporting.sandbox import markdown
from planrunner.reporting.show_page import timeline_table
from planrunner.reporting.view import render_report


def printed(*shown: RenderableType, width: int = 100) -> str:
    out = io.StringIO()
    console = terminal.console(width=width, file=out)
    for item in shown:
        console.print(item)
    return out.getvalue()


def test_summary() -> None:
    golden_files.check("summary.md", render_report(example.context(), "summary.md"))


def test_coefficients_and_limits() -> None:
    estimate = example.estimate()
    shown = terminal.coefficients_table(estimate, only=("D_X_F", "SF_X"))
    assert "xi" not in printed(shown)
    tables = [terminal.coefficients_table(estimate), terminal.limits_table(example.context().limits)]
    golden_files.check("coefficients.txt", printed(*tables, width=110))


def test_comparison_and_predictions() -> None:
    tables = [terminal.data_table(table) for table in example.comparison().tables]
    golden_files.check("comparison.txt", printed(*tables, terminal.predicted_table("drift", example.design())))


def test_timelines() -> None:
    shown = [terminal.schedule_table(schedule) for schedule in (example.schedule(), example.thermal_schedule())]
    golden_files.check("timeline.txt", printed(*shown, width=88))


def test_plain_text_without_a_terminal() -> None:
    text = printed(terminal.limits_table(example.context().limits))
    assert "\x1b" not in text
    assert "not met" in text


def test_text_from_files_drives_neither_the_terminal_nor_rich() -> None:
    table = Table("[bold]title[/bold]", (TableColumn("[red]column[/red]"),), (("\x1b[2J\x07[link=x]cell[/link]",),))
    text = printed(terminal.data_table(table))
    assert "[bold]title[/bold]" in text
    assert "[red]column[/red]" in text
    assert "\\x1b[2J\\x07[link=x]cell[/link]" in text
    assert "\x1b" not in text


def test_markdown_shows_text_as_it_stands() -> None:
    hostile = "a|b\n# c <script> [x](y) *d* `e` _f_ D_X_F"
    assert markdown(hostile) == "a\\|b # c &lt;script&gt; \\[x\\](y) \\*d\\* \\`e\\` \\_f\\_ D_X_F"
    summary = render_report(example.context(title=hostile), "summary.md")
    assert summary.splitlines()[0] == "# " + markdown(hostile)


def test_a_fact_that_is_not_stated_has_no_line() -> None:
    bench = {"name": "own", "description": ""}
    summary = render_report(example.context(bench=bench), "summary.md")
    assert "- Name: own" in summary
    assert "- Description:" not in summary
    assert "Description" not in render_report(example.context(bench=bench), "report.html")


def test_every_row_of_a_summary_table_has_as_many_cells_as_its_header() -> None:
    lines = render_report(example.context(), "summary.md").splitlines()
    for before, line in pairwise(lines):
        if line.startswith("|") and before.startswith("|"):
            assert line.count("|") == before.count("|"), line


def test_times_of_the_timeline_are_those_of_the_schedule() -> None:
    table = timeline_table(example.schedule())
    headings = table.headings
    start, end = headings.index("Start [h:mm:ss]"), headings.index("End [h:mm:ss]")
    # First position: 1500 s to reach, 600 s soak, 30 s settle = 35 min 30 s; then 120 s.
    assert (table.rows[0][start], table.rows[0][end]) == ("0:35:30", "0:37:30")
    # Every further position: 11.2 s move, 30 s settle, 120 s dwell: 18 × 161.2 s = 2901.6 s later the last one ends.
    assert table.rows[18][end] == "1:25:52"


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
def test_no_number_is_cut_however_narrow_the_terminal(width: int) -> None:
    numbers = tuple(f"{place}.{'123456789' * 2}{place}" for place in range(9))
    columns = tuple(TableColumn(f"column {place}", Role.VALUE, "deg/h") for place in range(9))
    table = Table("Wide", (TableColumn("name"), *columns), (("first", *numbers), ("a name of several words", *numbers)))
    text = printed(terminal.data_table(table), width=width)
    words = text.split()
    assert all(words.count(number) == 2 for number in numbers)
    assert max(map(len, text.splitlines())) <= width
    estimate = printed(terminal.coefficients_table(example.estimate()), width=width)
    assert "0.0000031" in estimate.split()
