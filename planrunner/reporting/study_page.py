"""The page of a design study, with results as facts, tables, charts and notes, from the template `design-study.html`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from planrunner.estimators.interface import Plot, Table
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, table_view


@dataclass(frozen=True, slots=True)
class StudyPage:
    """kicker: kind of study; footer: explanation of its figures."""

    kicker: str
    title: str
    facts: Mapping[str, str]
    tables: Sequence[Table]
    plots: Sequence[Plot]
    notes: Sequence[str]
    footer: str

    def render(self, folder: Path | None = None) -> str:
        """One self-contained HTML page. Raises `ReportError`."""
        from markupsafe import Markup

        from planrunner.reporting.plots import plot_svg

        given = {
            "kicker": self.kicker,
            "footer": self.footer,
            "title": self.title,
            "facts": named(self.facts),
            "tables": [table_view(table) for table in self.tables],
            "plots": [
                {"title": plot.title, "svg": Markup(plot_svg(plot, f"plot-{number}"))}
                for number, plot in enumerate(self.plots, start=1)
            ],
            "notes": list(self.notes),
        }
        return render("design-study.html", given, folder)
