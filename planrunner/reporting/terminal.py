"""Makes tables for the terminal with the library rich. If the output is not a terminal, rich prints plain text.

Text from files is not interpreted as markup, and control characters are shown as codes.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TextIO

from planrunner.estimators.interface import Coefficient, Design, Estimate
from planrunner.estimators.limits import LimitVerdict
from planrunner.estimators.tables import Table
from planrunner.plan.schedule import Schedule
from planrunner.reporting import words
from planrunner.reporting.printable import beneath, printable
from planrunner.reporting.show_page import timeline_table, totals
from planrunner.reporting.view import coefficient_row, limit_row, named, table_view

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment
    from rich.table import Table as RichTable
    from rich.text import Text

_GAP = 2  # between columns
_MOST_TEXT = 24  # minimum width of a text column on a narrow terminal, characters
PROBABILITY = 0.95
"""Coverage of the expanded uncertainties on the terminal."""
VERDICT = {"pass": "bold green", "warned": "bold yellow", "fail": "bold red", "none": "bold"}


def console(width: int | None = None, file: TextIO | None = None) -> Console:
    """Returns a rich console for these tables. If the output is not a terminal, the console is wide enough for unbroken rows and
    has no colour. The console raises `BrokenPipeError` if its pipe was closed."""
    from rich.console import Console
    from rich.segment import Segment

    class Piped(Console):
        """A console that lets the caller handle a closed pipe, as after `head`, instead of ending the process."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

        def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
            """Renders text with its control characters shown as codes. The control sequences of rich itself are kept separate from
            the text and stay unchanged."""
            for segment in super().render(renderable, options):
                text = segment.text if segment.control else printable(segment.text)
                yield segment if text == segment.text else Segment(text, segment.style)

    made = Piped(
        file=beneath(file or sys.stdout), width=width, highlight=False, markup=False, emoji=False, soft_wrap=False
    )
    if width is None and not made.is_terminal:
        made.width = 160
    return made


def coefficients_table(estimate: Estimate, only: Sequence[str] | None = None) -> RenderableType:
    """Returns a table of coefficients with their standard and expanded uncertainties. `only`: names of the coefficients to show,
    such as `estimate.headline`."""
    shown = [item for item in estimate.coefficients if only is None or item.name in only]
    return _coefficients(f"{estimate.name} ({estimate.estimator})", shown, "value")


def predicted_table(name: str, design: Design) -> RenderableType:
    """Returns a table of the uncertainties that are expected at the declared nominal values."""
    return _coefficients(f"{name}: predicted", design.predicted, "nominal")


def _coefficients(title: str, shown: Iterable[Coefficient], value: str) -> RenderableType:
    percent = words.number(100 * PROBABILITY)
    titles = ("coefficient", value, "u", f"± U ({percent} %)", "unit", "k", "d.o.f.")
    keys = ("name", "value", "standard", "expanded", "unit", "factor", "freedom")
    rows = [coefficient_row(item, PROBABILITY) for item in shown]
    columns = [(text, text not in ("coefficient", "unit")) for text in titles]
    return _Columns(title, columns, [[_text(row[key]) for key in keys] for row in rows])


def limits_table(limits: Sequence[LimitVerdict]) -> RenderableType:
    """Returns a table of limits with their verdicts in words, coloured on a terminal. The column P(false) contains the probability
    that the verdict is wrong."""
    titles = ("quantity", "requirement", "value", "± U", "unit", "k", "rule", "P(false)", "verdict")
    keys = ("quantity", "requirement", "value", "expanded", "unit", "factor", "rule_in_words", "false")
    rows, risks = [], []
    for limit in limits:
        row = limit_row(limit)
        verdict = f"{row['verdict']}: {row['reason']}" if row["reason"] else row["verdict"]
        rows.append([*(_text(row[key]) for key in keys), _text(verdict, VERDICT[row["kind"]])])
        if not math.isnan(limit.consumer_risk):
            wrong = f"nonconforming items accepted {row['consumer']}, conforming items rejected {row['producer']}"
            risks.append(f"{limit.quantity}, for all items that the prior describes: {wrong}")
    numeric = ("value", "± U", "k", "P(false)")
    return _Columns("Limits", [(text, text in numeric) for text in titles], rows, "\n".join(risks))


def data_table(given: Table) -> RenderableType:
    """Returns a table of an estimate, such as a comparison of two sets of coefficients."""
    view = table_view(given)
    columns = [(column["title"], column["numeric"]) for column in view["columns"]]
    rows = [[_text(cell) for cell in row] for row in view["rows"]]
    return _Columns(view["title"], columns, rows, view["more"])


def print_tables(*tables: Table) -> None:
    """Prints tables to standard output."""
    output = console()
    for table in tables:
        output.print(data_table(table))


def schedule_table(schedule: Schedule, title: str = "Timeline") -> RenderableType:
    """Returns a table of the timeline, followed by the totals."""
    from rich.console import Group

    table = timeline_table(schedule, brief=True)
    facts = _plain([(text.lower(), value) for text, value in named(totals(schedule))])
    return Group(data_table(replace(table, title=title)), facts)


def _plain(facts: Iterable[tuple[str, str]]) -> RichTable:
    from rich.table import Table as RichTable

    table = RichTable(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for name, value in facts:
        table.add_row(_text(name), _text(value))
    return table


@dataclass(frozen=True, slots=True)
class _Columns:
    """A table that is divided into several parts, one below the other, if its columns do not fit side by side.

    Numbers are never wrapped or cut. Titles and text are wrapped first. Then columns move to a further part, which repeats the
    first column. `columns`: pairs of a title and True if the column has numbers.
    """

    title: str
    columns: Sequence[tuple[str, bool]]
    rows: Sequence[Sequence[Text]]
    caption: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        for part, places in enumerate(self._parts(options.max_width)):
            yield self._table(f"{self.title} (continued)" if part else self.title, places, options.max_width)
        for line in self.caption.splitlines():
            yield _text(line)

    def _parts(self, width: int) -> list[list[int]]:
        """Returns the indices of the columns in each part. Every part begins with the first column."""
        least = [self._least(place, width) + _GAP for place in range(len(self.columns))]
        parts: list[list[int]] = [[]]
        for place, size in enumerate(least):
            if len(parts[-1]) > 1 and sum(least[other] for other in parts[-1]) + size + 1 > width:
                parts.append([0])
            parts[-1].append(place)
        return parts

    def _least(self, place: int, width: int) -> int:
        title, numeric = self.columns[place]
        longest = max((row[place].cell_len for row in self.rows), default=0)
        return max(longest if numeric else min(longest, _MOST_TEXT, width // 3), *map(len, title.split()), 1)

    def _table(self, title: str, places: Sequence[int], width: int) -> RichTable:
        from rich import box
        from rich.table import Table as RichTable

        style = {"title_justify": "left", "title_style": "bold", "header_style": "bold", "box": box.SIMPLE_HEAD}
        table = RichTable(title=_text(title), pad_edge=False, padding=(0, 0, 0, 1), **style)  # type: ignore[arg-type]
        least = {place: self._least(place, width) for place in places}
        texts = [place for place in places if not self.columns[place][1]]
        spare = max(0, width - 1 - sum(least.values()) - _GAP * len(places)) // max(1, len(texts))
        for place in places:
            name, numeric = self.columns[place]
            most = None if numeric else least[place] + spare
            justify: Literal["left", "right"] = "right" if numeric else "left"
            table.add_column(_text(name), justify=justify, min_width=least[place], max_width=most, overflow="fold")
        for row in self.rows:
            table.add_row(*(row[place] for place in places))
        return table


def _text(words_: str, style: str = "") -> Text:
    from rich.text import Text

    return Text(printable(words_, keep=""), style=style)
