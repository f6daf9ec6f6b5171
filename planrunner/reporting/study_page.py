"""Renders the page of a design study: facts, notes, tables, orientations and curves. The template of the page is
`templates/design.html.j2`."""

from __future__ import annotations

from planrunner.design.study import Study
from planrunner.reporting.orientations import orientation_svg
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, table_view


def render_page(study: Study) -> str:
    """Renders one self-contained HTML page. Raises `ReportError` if the page cannot be rendered."""
    from markupsafe import Markup

    from planrunner.reporting.plots import plot_svg

    given = {
        "kicker": f"Design of {study.varied}",
        "footer": study.footer,
        "title": study.subject.title,
        "facts": named({**study.subject.facts, **study.facts}),
        "tables": [table_view(table) for table in study.tables],
        "pictures": [
            {
                "title": title,
                "figures": [
                    {"svg": Markup(orientation_svg(one.attitude, one.label)), "label": one.label, "words": one.words}
                    for one in poses
                ],
            }
            for title, poses in study.poses.items()
        ],
        "plots": [
            {"title": plot.title, "svg": Markup(plot_svg(plot, f"plot-{number}"))}
            for number, plot in enumerate(study.plots, start=1)
        ],
        "notes": list(study.notes),
    }
    return render("design.html", given)
