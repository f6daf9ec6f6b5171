"""Draws charts as inline SVG: values by label or over x, curves, correlations, and the timeline of a schedule.

Matplotlib draws the charts at the width of a phone, and the page scales them, so that text is legible on phones and on large
screens. Text in a chart is stored as text. Equal data give equal bytes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.findings import count_of
from planrunner.estimators.tables import Plot
from planrunner.plan.schedule import Schedule
from planrunner.reporting.words import clock

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType


WIDTH = 4.7  # inches
COLOURS = ("#0b5394", "#b45309", "#3f7d3a", "#7b3fa0", "#5f6b76")
_MARKERS = ("o", "s", "^", "D", "v")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))  # distinguishable in print without colour
_MARGIN = 3.0  # points around all lettering
MOST_POINTS = 2000  # of a plotted curve
_STYLE: dict[RcKeyType, object] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "planrunner",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.edgecolor": "#8a949e",
    "axes.labelcolor": "#1b1f24",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#e3e7eb",
    "grid.linewidth": 0.7,
    "xtick.color": "#3b444d",
    "ytick.color": "#3b444d",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "text.parse_math": False,
}


def plot_svg(plot: Plot, key: str) -> str:
    """Returns one chart: points with error bars (±1 standard uncertainty) over labels, points and lines over numbers, or curves.

    `key`: a name of letters, digits and hyphens that is unique in the page. All ids in the picture begin with this key.
    """
    labels = _labels(plot.x)
    with drawing(WIDTH, 3.1) as (figure, save):
        axes = figure.add_subplot()
        if plot.lines and not labels:
            _draw_courses(axes, plot)
        else:
            _draw_points(axes, plot, labels)
        if plot.log and not labels and any(value > 0 for values in plot.series.values() for value in values):
            axes.set_xscale("log")
            axes.set_yscale("log")
            _plain_ticks(axes)
        _finish(axes, plot, labels)
        described = f"{plot.y_title} against {plot.x_title}, {len(plot.x)} points, series: {', '.join(plot.series)}"
        return save(key, plot.title, described)


def _plain_ticks(axes: Axes) -> None:
    """Formats the numbers at logarithmic axes as plain text, because formulas are not drawn in these charts. An axis of less than
    two decades also shows 2 and 5."""

    def between(value: float, _: float) -> str:
        leading = round(value / 10 ** math.floor(math.log10(value)), 6)
        return f"{value:g}" if leading in (2, 5) else ""

    def nothing(value: float, _: float) -> str:
        return ""

    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(between if high < 100 * low else nothing)


def _draw_points(axes: Axes, plot: Plot, labels: list[str]) -> None:
    xs = np.arange(len(labels), dtype=float) if labels else np.array([float(x) for x in plot.x])
    count = max(len(plot.series), 1)
    for index, (name, values) in enumerate(plot.series.items()):
        shift = (index - (count - 1) / 2) * min(0.16, 0.6 / count) if labels else 0.0
        width = plot.uncertainties.get(name)
        axes.errorbar(
            xs + shift,
            np.array(values, dtype=float),
            yerr=None if width is None else np.array(width, dtype=float),
            fmt=_MARKERS[index % len(_MARKERS)] if labels or len(xs) <= 60 else "",
            linestyle="none" if labels else "-",
            color=COLOURS[index % len(COLOURS)],
            markersize=4.5,
            linewidth=1.1,
            capsize=2.5,
            label=name,
        )


def _draw_courses(axes: Axes, plot: Plot) -> None:
    """Draws each series as a line, and its standard uncertainty, if given, as a band about the line. A non-finite value interrupts
    the line."""
    xs = np.array([float(x) for x in plot.x])
    for index, (name, values) in enumerate(plot.series.items()):
        colour = COLOURS[index % len(COLOURS)]
        course = np.array(values, dtype=float)
        shown = thinned(course)
        dashes = _DASHES[index % len(_DASHES)]
        axes.plot(xs[shown], course[shown], linestyle=dashes, color=colour, linewidth=1.2, label=name)
        if name in plot.uncertainties:
            width = np.array(plot.uncertainties[name], dtype=float)[shown]
            low, high = course[shown] - width, course[shown] + width
            axes.fill_between(xs[shown], low, high, color=colour, alpha=0.18, linewidth=0)
    if len(xs) > 1 and not plot.log:
        axes.set_xlim(np.nanmin(xs), np.nanmax(xs))


def thinned(values: Array) -> NDArray[np.intp]:
    """Selects the values of a curve that are drawn; returns their indices. The curve has n values. A curve of up to `MOST_POINTS`
    values is drawn completely. A longer curve is divided into many equal intervals. Only some values are drawn: the first and last
    value of the curve, and the lowest, the highest and the first non-finite value of each interval. Thus, no peak and no gap is
    lost."""
    if len(values) <= MOST_POINTS:
        return np.arange(len(values))
    kept = {0, len(values) - 1}
    for stretch in np.array_split(np.arange(len(values)), max(1, (MOST_POINTS - 2) // 3)):
        part = values[stretch]
        finite = np.isfinite(part)
        if finite.any():
            kept.add(int(stretch[np.argmin(np.where(finite, part, np.inf))]))
            kept.add(int(stretch[np.argmax(np.where(finite, part, -np.inf))]))
        if not finite.all():
            kept.add(int(stretch[np.argmin(finite)]))
    return np.array(sorted(kept))


def _labels(x: Sequence[object]) -> list[str]:
    """Returns the items of x as labels if at least one item is a text; otherwise an empty list."""
    return [str(item) for item in x] if any(isinstance(item, str) for item in x) else []


def _finish(axes: Axes, plot: Plot, labels: list[str]) -> None:
    axes.set_xlabel(plot.x_title)
    axes.set_ylabel(plot.y_title)
    lowest, highest = axes.get_ylim()
    if lowest < 0 < highest and axes.get_yscale() == "linear":
        axes.axhline(0, color="#8a949e", linewidth=0.8, zorder=1)
    if labels:
        step = math.ceil(len(labels) / 40)
        shown = range(0, len(labels), step)
        steep = len(labels) > 12 or max(map(len, labels)) > 4
        axes.set_xticks(list(shown), [labels[i][:24] for i in shown], rotation=90 if steep else 0)
        axes.grid(visible=False, axis="x")
        axes.set_xlim(-0.6, len(labels) - 0.4)
    if len(plot.series) > 1:
        columns = 2 if max(map(len, plot.series)) > 12 else 3
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(columns, len(plot.series)), borderaxespad=0.2)


def correlation(covariance: Array) -> Array:
    """Returns the correlation matrix that belongs to a covariance matrix (m, m). For a quantity without variance, the elements off
    the diagonal are zero."""
    sigma = np.sqrt(np.clip(np.diag(covariance), 0, None))
    scale = np.where(sigma > 0, sigma, np.inf)
    result = covariance / np.outer(scale, scale)
    np.fill_diagonal(result, 1.0)
    return np.asarray(np.clip(result, -1, 1))


def correlation_svg(names: Sequence[str], covariance: Array, key: str) -> str:
    """Returns a heat map of the correlations in hundredths: positive values are blue, negative values are orange, and zero is
    white."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LinearSegmentedColormap

    matrix = correlation(np.asarray(covariance, dtype=float))
    size = len(names)
    with drawing(WIDTH, WIDTH * 0.97) as (figure, save):
        axes = figure.add_subplot()
        colours = LinearSegmentedColormap.from_list("correlation", ["#b45309", "#ffffff", "#0b5394"])
        corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        middles = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 1, 2)
        cells = PolyCollection(list(middles + corners), facecolors=colours((matrix.ravel() + 1) / 2), linewidths=0)
        axes.add_collection(cells, autolim=False)
        for row in range(size):
            for column in range(size):
                value = float(matrix[row, column])
                if size <= 16 and abs(value) >= 0.005 and row != column:
                    ink = "#ffffff" if abs(value) > 0.55 else "#1b1f24"
                    text = f"{100 * value:.0f}".replace("-", "\u2212")
                    lettering = axes.text(column, row, text, ha="center", va="center", fontsize=7.2, color=ink)
                    lettering.set_in_layout(False)  # the number is inside its cell
        places = range(0, size, math.ceil(size / 40))
        axes.set_xticks(list(places), [names[i] for i in places], rotation=90)
        axes.set_yticks(list(places), [names[i] for i in places])
        axes.set_xlim(-0.5, size - 0.5)
        axes.set_ylim(size - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.tick_params(length=0, labelsize=8)
        strongest = [f"{a} and {b} {r:+.2f}" for a, b, r in strong(names, matrix)[:5]]
        described = "Largest: " + "; ".join(strongest) if strongest else "No two coefficients are correlated."
        return save(key, f"Correlations of {size} coefficients, in hundredths", described)


def strong(names: Sequence[str], matrix: Array, at_least: float = 0.3) -> list[tuple[str, str, float]]:
    """Returns the pairs of names whose correlation has an absolute value of at least `at_least`, the strongest first."""
    pairs = [
        (names[i], names[j], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(matrix[i, j]) >= at_least
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def timeline_svg(schedule: Schedule, key: str) -> str:
    """Draws the timeline of a schedule: transitions, settling and recording are bars. The timeline also shows temperature and rate
    if the plan states them."""
    from planrunner.reporting.timeline import draw_panels, panels_of

    panels = panels_of(schedule)
    with drawing(7.2, 0.75 + 0.95 * len(panels)) as (figure, save):
        rows = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
        draw_panels(rows, panels, schedule)
        described = (
            f"{count_of(len(schedule.segments), 'segment')} in {clock(schedule.total)} (hours, minutes, seconds)."
        )
        return save(key, "Timeline of the planned run", described)


@contextmanager
def drawing(width: float, height: float) -> Iterator[tuple[Figure, Callable[[str, str, str], str]]]:
    """Yields a figure in the project's style, and a function that turns the figure into an `<svg>` element."""
    import io

    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height))

        def save(key: str, title: str, described: str) -> str:
            target = io.StringIO()
            nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
            canvas = FigureCanvasSVG(figure)
            _make_room(figure)
            # What `savefig` does, without its first drawing, which only measures for margins that are known already.
            canvas.print_svg(target, metadata=nothing)  # type: ignore[no-untyped-call]
            return _inline(target.getvalue(), key, title, described)

        yield figure, save


def _make_room(figure: Figure) -> None:
    """Sets the margins of a figure with one column of axes, so that the text around the axes is within the figure.

    The text is measured only once: matplotlib's constrained layout measures it twice, and measuring takes as long as drawing.
    """
    width, height = 72 * figure.get_size_inches()
    across, upright = _MARGIN / width, _MARGIN / height
    margins = []
    for axes in figure.axes:
        axes.apply_aspect()
        measured = axes.get_tightbbox(for_layout_only=True)
        assert measured is not None  # the axes are visible
        around = measured.transformed(figure.transFigure.inverted())
        inner = axes.get_position()
        margins.append((inner.x0 - around.x0, around.x1 - inner.x1, inner.y0 - around.y0, around.y1 - inner.y1))
    sides = np.array(margins)
    between = max((upper[2] + lower[3] + upright for upper, lower in pairwise(sides)), default=0.0)
    left, right = _bounded(sides[:, :2].max(axis=0) + across)
    bottom, top, *gaps = _bounded(
        np.array([sides[-1, 2] + upright, sides[0, 3] + upright, *[between] * (len(sides) - 1)])
    )
    room = (1 - bottom - top - sum(gaps)) / len(sides)
    figure.subplots_adjust(left=left, right=1 - right, bottom=bottom, top=1 - top, hspace=(gaps or [0.0])[0] / room)


def _bounded(margins: Array) -> Array:
    """Reduces the margins, which are fractions of the figure, so that at least a tenth of the figure remains for the axes, even if
    the text is long."""
    return margins * min(1.0, 0.9 / float(margins.sum()))


def _inline(text: str, key: str, title: str, described: str) -> str:
    """Converts the file from matplotlib to an `<svg>` element that scales with its container. The element has no prologue; it has a
    name and unique ids."""
    body = text[text.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"<style\b.*?</style>\s*", "", body, flags=re.DOTALL)  # its only rule is in `named`
    body = re.sub(r"<[^<>]+>", _with_attributes, body)
    body = re.sub(r'\bid="', f'id="{key}-', body)
    body = re.sub(r'(xlink:href="|url\()#', rf"\1#{key}-", body)
    body = body.replace("'DejaVu Sans'", "'DejaVu Sans', 'Verdana', 'Segoe UI', 'Helvetica', sans-serif")
    opening, rest = body.split(">", 1)
    opening = re.sub(r'\s(?:width|height)="[^"]*"', "", opening)
    named = f' class="chart" stroke-linejoin="round" stroke-linecap="butt" role="img" aria-labelledby="{key}-title {key}-desc"'
    words = f'<title id="{key}-title">{escape(title)}</title><desc id="{key}-desc">{escape(described)}</desc>'
    return f"{opening}{named}>{words}{rest}".strip()


def _with_attributes(tag: re.Match[str]) -> str:
    """Returns a tag in which the style is replaced by attributes, because pages permit no style outside the style sheet in their
    head."""
    return re.sub(r' style="([^"]*)"', _attributes, tag[0])


def _attributes(style: re.Match[str]) -> str:
    pairs = (rule.split(":", 1) for rule in style[1].split(";") if rule.strip())
    return "".join(f' {name.strip()}="{value.strip()}"' for name, value in pairs)
