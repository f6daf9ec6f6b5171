"""Shows the history of a coefficient as one page: sentences, control charts, a table of the values, and the agreement of benches
and laboratories."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from planrunner.base.findings import count_of
from planrunner.instruments.models import DataOrigin
from planrunner.night.history.control_charts import Chart
from planrunner.night.history.trend import Trend
from planrunner.reporting.history_tables import agreement_table, points_table, sentences
from planrunner.reporting.plots import COLOURS, WIDTH, drawing
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, stamped, table_view


def render_history(found: Trend) -> str:
    """Renders one self-contained HTML page. Raises `ReportError` if the page cannot be rendered."""
    from markupsafe import Markup

    origins = {point.run.origin for point in found.points}
    origin: DataOrigin | None = "simulated" if "simulated" in origins else "replayed" if "replayed" in origins else None
    tables = [points_table(found)]
    if found.benches:
        tables.append(agreement_table("benches", found.benches, found.unit))
    if found.laboratories:
        tables.append(agreement_table("laboratories", found.laboratories, found.unit))
    facts = {
        "Device": found.device,
        "Coefficient": found.quantity,
        "Unit": found.unit or "1",
        "Runs": str(len(found.points)),
        "From": found.points[0].run.created[:10] if found.points else "",
        "To": found.points[-1].run.created[:10] if found.points else "",
    }
    given = {
        "title": f"{found.quantity} of {found.device}",
        "facts": named(facts),
        "sentences": sentences(found),
        "stamp": stamped(origin),
        "plots": [{"title": title, "svg": Markup(svg)} for title, svg in pictures(found)],
        "tables": [table_view(table) for table in tables],
    }
    return render("history.html", given)


def pictures(found: Trend) -> Iterator[tuple[str, str]]:
    """Yields the title and the SVG of each chart. The charts show the values with Shewhart limits and the limits of the plan, the
    moving average, and the cumulative sums."""
    charts = found.charts
    if charts is None:
        return
    unit = f" [{found.unit}]" if found.unit not in ("", "1") else ""
    yield (
        "Values (Shewhart chart)",
        _chart(found, "values", f"{found.quantity}{unit}", [("value", charts.shewhart)], bars=True),
    )
    yield "Moving average (EWMA chart)", _chart(found, "ewma", f"average{unit}", [("EWMA", charts.ewma)])
    sums = [("sum upwards", charts.cusum_up), ("sum downwards", charts.cusum_down)]
    yield "Cumulative sums (CUSUM chart)", _chart(found, "cusum", "sum [σ]", sums)


def _chart(found: Trend, key: str, y_title: str, series: list[tuple[str, Chart]], *, bars: bool = False) -> str:
    """Draws one chart over the dates, with its limits as lines, its alarms as rings, and the changes of level as dotted lines."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

    days = [float(date2num(datetime.fromisoformat(point.run.created))) for point in found.points]  # type: ignore[no-untyped-call]
    with drawing(WIDTH, 3.1) as (figure, save):
        axes = figure.add_subplot()
        ringed = False
        for place, (name, chart) in enumerate(series):
            colour = COLOURS[place]
            if bars:
                u = found.standard_uncertainties
                axes.errorbar(
                    days, chart.statistic, yerr=u, fmt="o", markersize=3, color=colour, linewidth=0.9, label=name
                )
            else:
                axes.plot(days, chart.statistic, "o-", markersize=3, color=colour, linewidth=1.0, label=name)
            label = "control limits" if place == 0 else None
            axes.plot(days, chart.lower, "--", color=COLOURS[4], linewidth=0.9, label=label)
            axes.plot(days, chart.upper, "--", color=COLOURS[4], linewidth=0.9)
            rings = [k for k in range(len(days)) if chart.alarms[k]]
            ring = "alarm" if rings and not ringed else None
            ringed = ringed or bool(rings)
            axes.plot(
                [days[k] for k in rings],
                [chart.statistic[k] for k in rings],
                "o",
                markersize=9,
                fillstyle="none",
                color=COLOURS[1],
                label=ring,
            )
        for change in found.changes:
            middle = (days[change.index - 1] + days[change.index]) / 2
            axes.axvline(middle, linestyle=":", color=COLOURS[3], linewidth=1.2)
        locator = AutoDateLocator(minticks=2, maxticks=6)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        axes.set_ylabel(y_title)
        # Above the axes: inside, it could cover a value.
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3 if len(series) == 1 else 2, borderaxespad=0.2)
        alarms = count_of(sum(int(one.alarms.sum()) for _, one in series), "alarm")
        described = f"{y_title} of {count_of(len(days), 'run')} with control limits; {alarms}"
        return save(f"history-{key}", y_title, described)
