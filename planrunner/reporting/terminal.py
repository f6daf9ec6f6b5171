"""Tables for the terminal, as rich renderables; on anything but a terminal rich prints them as plain text.

Text from files is shown as it stands: no markup is read from it and control characters are shown as codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from planrunner.estimators.interface import Coefficient, Design, Estimate, Table
from planrunner.plan.schedule import Schedule
from planrunner.reporting import words
from planrunner.reporting.context import LimitVerdict
from planrunner.reporting.show_page import timeline_table, totals
from planrunner.reporting.view import coefficient_row, limit_row, named, table_view

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table as RichTable
    from rich.text import Text

_LEAST = {
    "Orientation": 24,
    "Segment": 5,
    "Start": 7,
    "Dwell": 5,
}  # columns that must stay readable on a narrow terminal
_VERDICT = {"pass": "bold green", "fail": "bold red"}


def console(width: int | None = None, file: Any = None) -> Console:
    """A console for these tables. Away from a terminal it is wide enough not to break rows, and has no colour."""
    from rich.console import Console

    made = Console(file=file, width=width, highlight=False, markup=False, emoji=False, soft_wrap=False)
    if width is None and not made.is_terminal:
        made.width = 160
    return made


def coefficients_table(
    estimate: Estimate, probability: float = 0.95, only: Sequence[str] | None = None
) -> RenderableType:
    """Coefficients with standard and expanded uncertainties. only: names to show, such as `estimate.headline`."""
    shown = [item for item in estimate.coefficients if only is None or item.name in only]
    return _coefficients(f"{estimate.name} ({estimate.estimator})", shown, probability, "value")


def predicted_table(name: str, design: Design, probability: float = 0.95) -> RenderableType:
    """The uncertainties to expect, at the declared nominal values."""
    return _coefficients(f"{name}: predicted", design.predicted, probability, "nominal")


def _coefficients(title: str, shown: Iterable[Coefficient], probability: float, value: str) -> RichTable:
    percent = words.number(100 * probability)
    titles = ("coefficient", value, "u", f"± U ({percent} %)", "unit", "k", "d.o.f.")
    keys = ("name", "value", "standard", "expanded", "unit", "factor", "freedom")
    table = _table(title, [(text, text not in ("coefficient", "unit")) for text in titles])
    for item in shown:
        row = coefficient_row(item, probability)
        table.add_row(*(_text(row[key]) for key in keys))
    return table


def limits_table(limits: Sequence[LimitVerdict]) -> RenderableType:
    """Limits with their verdicts, coloured on a terminal and always in words."""
    titles = ("quantity", "requirement", "value", "± U", "unit", "k", "rule", "verdict")
    keys = ("quantity", "requirement", "value", "expanded", "unit", "factor", "rule")
    table = _table("Limits", [(text, text in ("value", "± U", "k")) for text in titles])
    for limit in limits:
        row = limit_row(limit)
        verdict = f"{row['verdict']}: {row['reason']}" if row["reason"] else row["verdict"]
        table.add_row(*(_text(row[key]) for key in keys), _text(verdict, _VERDICT[row["kind"]]))
    return table


def data_table(given: Table) -> RenderableType:
    """A table of an estimate, such as a comparison of two sets of coefficients."""
    view = table_view(given)
    table = _table(view["title"], [(column["title"], column["numeric"]) for column in view["columns"]])
    for row in view["rows"]:
        table.add_row(*(_text(cell) for cell in row))
    if view["more"]:
        table.caption = view["more"]
    return table


def schedule_table(schedule: Schedule, title: str = "Timeline") -> RenderableType:
    """The timeline, then the totals."""
    from rich.console import Group

    table = timeline_table(schedule, brief=True)
    facts = _plain([(text.lower(), value) for text, value in named(totals(schedule))])
    return Group(data_table(Table(title, table.columns, table.rows)), facts)


def facts_table(facts: Sequence[tuple[str, str]]) -> RenderableType:
    """Names and values in two columns, without rules."""
    return _plain(facts)


def _plain(facts: Iterable[tuple[str, str]]) -> RichTable:
    from rich.table import Table as RichTable

    table = RichTable(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for name, value in facts:
        table.add_row(_text(name), _text(value))
    return table


def _table(title: str, columns: Sequence[tuple[str, bool]]) -> RichTable:
    from rich import box
    from rich.table import Table as RichTable

    table = RichTable(
        title=_text(title),
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        header_style="bold",
    )
    for name, numeric in columns:
        table.add_column(
            _text(name), justify="right" if numeric else "left", no_wrap=numeric, min_width=_LEAST.get(name)
        )
    return table


def _text(words_: str, style: str = "") -> Text:
    from rich.text import Text

    return Text(printable(words_), style=style)


def printable(text: str) -> str:
    """Control characters as codes, so that text from a file cannot drive the terminal."""
    return "".join(char if char.isprintable() else f"\\x{ord(char):02x}" for char in text)
