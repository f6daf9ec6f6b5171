"""Draws the pictures of a diagnosis: the heat map over segments and channels, spectra, means of segments, probabilities, and the
confusability of effects."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.documents import Json, JsonObject
from planrunner.estimators.tables import Plot
from planrunner.reporting.plots import COLOURS, WIDTH, drawing, plot_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap

Data = Mapping[str, Json]

SHOWN = 0.005
"""A hypothesis is shown separately if its probability is at least this value. The other hypotheses are combined as `others`."""


MOST_HYPOTHESES = 12


def ranked(found: Data) -> list[tuple[str, float]]:
    """Returns the hypotheses to show, the most probable first; all other hypotheses are combined as `others`."""
    posterior: Mapping[str, float] = found["posterior"]
    order = sorted(posterior.items(), key=lambda pair: -pair[1])
    shown = [(name, p) for name, p in order if p >= SHOWN][:MOST_HYPOTHESES]
    rest = sum(posterior.values()) - sum(p for _, p in shown)
    return [*shown, ("others", rest)] if rest > SHOWN / 10 else shown


MOST_CHANNELS = 6
"""Maximum number of channels with plots of spectra and means. The channels with the largest gap are chosen."""
HOTTEST = 100.0
"""The colour scale of the heat map ends at this value, in units of the noise. If the largest value in the map is 1000 or more, the
scale ends at the largest power of ten that does not exceed that value."""


def pictures(found: Data) -> list[JsonObject]:
    """Returns the pictures for which the diagnosis has data: for each, the title, a description, the SVG, and True if the picture
    spans the full width of the page."""
    from markupsafe import Markup

    made = []
    for title, words, wide, svg in _drawn(found):
        made.append({"title": title, "words": words, "wide": wide, "svg": Markup(svg)})
    return made


def _drawn(found: Data) -> Iterator[tuple[str, str, bool, str]]:
    data: Data = found.get("pictures") or {}
    heat = data.get("heat")
    if heat and heat["segments"] and heat["channels"]:
        words = "Energy of the residuals of the simulation, relative to the energy of noise alone; 1 means noise alone."
        yield "Gap over segments and channels", words, True, heat_svg(heat, "heat")
    yield "Probability of each explanation", "", False, posterior_svg(ranked(found), "posterior")
    alike = data.get("confusability")
    if alike and len(alike["effects"]) > 1:
        words = (
            "Share of the row's effect that the column's effect reproduces with this plan, in per cent; at 100 the two effects cannot "
            "be distinguished."
        )
        yield "Effects that this plan can confuse", words, False, confusability_svg(alike, "confusability")
    form: Data = found.get("unknown_form") or {}
    for place, name in enumerate(form.get("channels", [])[:MOST_CHANNELS] if form.get("points") else []):
        words = (
            "Offsets that the simulation and its fitted parameters do not explain, with their standard uncertainties."
        )
        yield f"Form of the unknown in {name}", words, False, plot_svg(_form(form, place), f"form-{_key(name)}")
    compared: Data = found.get("comparison") or {}
    for name, one in _largest(found, compared.get("channels", {})):
        words = "Offsets of the segments after the fit of the nominal parameters."
        yield (
            f"{name}: recording and simulations",
            words,
            False,
            plot_svg(_compared(name, compared, one), f"compared-{_key(name)}"),
        )
    for name, one in _largest(found, data.get("means", {}).get("channels", {})):
        yield (
            f"Segment means of {name}, before and after",
            "",
            False,
            plot_svg(_means(name, data["means"]["segments"], one), f"means-{_key(name)}"),
        )
    for name, one in _largest(found, data.get("spectrum", {})):
        yield (
            f"Spectrum of {name}, before and after",
            "",
            False,
            plot_svg(_spectrum(name, one), f"spectrum-{_key(name)}"),
        )


def _largest(found: Data, channels: Data) -> list[tuple[str, Data]]:
    def size(name: str) -> float:
        one = found["gap"].get(name) or {}
        before, floor = one.get("before"), one.get("noise_floor")
        return -float(before) / float(floor) if before and floor else 0.0

    return [(name, channels[name]) for name in sorted(channels, key=size)[:MOST_CHANNELS]]


def _means(name: str, segments: Sequence[str], one: Data) -> Plot:
    series = {key: _numbers(one[key]) for key in ("before", "after")}
    bars = {"before": _numbers(one["noise"]), "after": _numbers(one["noise"])} if "noise" in one else {}
    return Plot(f"Segment means of {name}", "segment", f"residual [{one['unit']}]", tuple(segments), series, bars)


def _form(form: Data, place: int) -> Plot:
    points = form["points"]
    series = {"offset": _numbers([one["values"][place] for one in points])}
    bars = {"offset": _numbers([one["standard_uncertainties"][place] for one in points])}
    levels = tuple(one["level"] for one in points)
    title = f"Form of the unknown in {form['channels'][place]}"
    return Plot(title, str(form["factor"]), f"offset [{form['units'][place]}]", levels, series, bars)


def _compared(name: str, compared: Data, one: Data) -> Plot:
    means = one["means"]
    names = {"recorded": "recording", "before": "simulation without", "after": "simulation with"}
    series = {words: _numbers(means[key]) for key, words in names.items()}
    bars = {words: _numbers(means["noise"]) for words in names.values()}
    title = f"{name}: recording and simulations"
    return Plot(title, "segment", f"offset [{one['unit']}]", tuple(compared["segments"]), series, bars)


def _spectrum(name: str, one: Data) -> Plot:
    series = {key: _numbers(one[key]) for key in ("before", "after", "noise") if key in one}
    x = tuple(one["frequency_hz"])
    return Plot(f"Spectrum of {name}", "frequency [Hz]", f"density [{one['unit']}]", x, series, log=True, lines=True)


def heat_svg(heat: Data, key: str) -> str:
    """Returns a heat map of the gap, with one row for each channel and one column for each segment. White represents noise alone; a
    darker field represents a larger gap, on a logarithmic scale."""
    from matplotlib.colors import LinearSegmentedColormap

    channels, segments = list(heat["channels"]), list(heat["segments"])
    values = np.array([_numbers(row) for row in heat["values"]], dtype=float).reshape(len(channels), len(segments))
    hottest = max(HOTTEST, 10.0 ** math.floor(math.log10(max(float(np.nanmax(values, initial=1.0)), 1.0))))
    depth = np.clip(np.log(np.maximum(np.nan_to_num(values, nan=1.0), 1.0)) / math.log(hottest), 0, 1)
    colours = LinearSegmentedColormap.from_list("gap", ["#ffffff", "#f2c48d", "#b45309", "#4a1d02"])
    with drawing(7.2, 1.5 + 0.24 * len(channels)) as (figure, save):
        axes = figure.add_subplot()
        axes.pcolormesh(
            np.arange(len(segments) + 1) - 0.5, np.arange(len(channels) + 1) - 0.5, depth,
            cmap=colours, vmin=0, vmax=1, edgecolors="#e3e7eb", linewidth=0.3,
        )  # fmt: skip
        axes.set_yticks(range(len(channels)), channels)
        places = range(0, len(segments), math.ceil(len(segments) / 52))
        axes.set_xticks(list(places), [segments[place][:24] for place in places], rotation=90)
        axes.set_xlim(-0.5, len(segments) - 0.5)
        axes.set_ylim(len(channels) - 0.5, -0.5)
        axes.grid(visible=False)
        axes.tick_params(length=0, labelsize=7)
        _legend(axes, colours, hottest)
        row, column = np.unravel_index(int(np.argmax(np.nan_to_num(values))), values.shape)
        described = f"Largest: {channels[row]} in {segments[column]}, {values[row, column]:.3g} times noise."
        return save(key, f"Gap of {len(channels)} channels over {len(segments)} segments", described)


def _legend(axes: Axes, colours: Colormap, hottest: float) -> None:
    """Draws the legend of the colours, as labelled squares above the map."""
    for step in range(5):
        times = hottest ** (step / 4)
        label = f"{float(f'{times:.1g}'):g} ×" if step < 4 else f"{times:g} × and more"
        axes.scatter(
            [], [], marker="s", s=45, color=colours(step / 4), edgecolors="#8a949e", linewidths=0.6, label=label
        )
    axes.legend(
        loc="lower left", bbox_to_anchor=(0, 1.0), ncols=5, borderaxespad=0.2, handletextpad=0.3, columnspacing=1.2
    )


def posterior_svg(hypotheses: Sequence[tuple[str, float]], key: str) -> str:
    """Returns a chart with one bar for each hypothesis, labelled with its probability."""
    with drawing(WIDTH, 0.9 + 0.27 * len(hypotheses)) as (figure, save):
        axes = figure.add_subplot()
        for row, (name, p) in enumerate(hypotheses):
            nobody = name in ("none", "unknown", "others")
            axes.barh(row, p, height=0.66, color=COLOURS[4] if nobody else COLOURS[0])
            axes.text(p + 0.012, row, f"{p:.3f}" if p < 0.9995 else "> 0.999", va="center", fontsize=8)
        axes.set_yticks(range(len(hypotheses)), [name.replace("+", " +\n") for name, _ in hypotheses])
        axes.set_ylim(len(hypotheses) - 0.4, -0.6)
        axes.set_xlim(0, 1.16)
        axes.set_xticks([0, 0.25, 0.5, 0.75, 1])
        axes.set_xlabel("probability")
        axes.grid(visible=False, axis="y")
        described = "; ".join(f"{name} {p:.3f}" for name, p in hypotheses)
        return save(key, "Probability of each explanation", described)


def confusability_svg(alike: Data, key: str) -> str:
    """Returns a map of the confusability in hundredths. Each row represents an effect that causes a signature. Each column
    represents an effect that reproduces this signature."""
    from matplotlib.colors import LinearSegmentedColormap

    names = list(alike["effects"])
    shares = np.array([_numbers(row) for row in alike["shares"]], dtype=float)
    size = len(names)
    colours = LinearSegmentedColormap.from_list("alike", ["#ffffff", "#0b5394"])
    wide = WIDTH * min(1.0, 0.5 + size / 16)
    with drawing(wide, wide * 1.02) as (figure, save):
        axes = figure.add_subplot()
        edges = np.arange(size + 1) - 0.5
        axes.pcolormesh(
            edges, edges, np.nan_to_num(shares), cmap=colours, vmin=0, vmax=1, edgecolors="#e3e7eb", linewidth=0.3
        )
        if size <= 16:
            for row in range(size):
                for column in range(size):
                    value = float(shares[row, column])
                    if row != column and value >= 0.005:
                        ink = "#ffffff" if value > 0.55 else "#1b1f24"
                        axes.text(column, row, f"{100 * value:.0f}", ha="center", va="center", fontsize=6.5, color=ink)
        axes.set_xticks(range(size), names, rotation=90)
        axes.set_yticks(range(size), names)
        axes.set_xlim(-0.5, size - 0.5)
        axes.set_ylim(size - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.tick_params(length=0, labelsize=6.5 if size > 16 else 7.5)
        off = np.where(np.eye(size, dtype=bool), -1.0, np.nan_to_num(shares))
        first, second = divmod(int(np.argmax(off)), size)
        described = f"Most similar pair: {names[second]} reproduces {off[first, second]:.0%} of {names[first]}."
        return save(key, f"Confusability of {size} effects", described)


def _numbers(values: Sequence[float | None]) -> tuple[float, ...]:
    return tuple(math.nan if value is None else float(value) for value in values)


def _key(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name)
