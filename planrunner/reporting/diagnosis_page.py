"""Makes the output of a diagnosis: sentences and tables for the terminal, and one page with pictures.

The pictures are the heat map over segments and channels, spectra, means of segments, probabilities, and the confusability of
effects.

The input is plain data according to `schemas/diagnosis.schema.json`. Only fractions and rounded numbers are computed here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import count_of
from planrunner.estimators.tables import Plot, Role, Shown, Table, TableColumn, alike, table_of
from planrunner.instruments.models import DataOrigin
from planrunner.reporting.plots import COLOURS, WIDTH, drawing, plot_svg
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, stamped, table_view
from planrunner.reporting.words import explanation, listed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap

SURE = 0.95
"""The page reports no gap if the probability of pure noise is at least this value."""
CONSPICUOUS = 0.05
"""A deviation is shown if noise alone would cause it with at most this probability (its p-value)."""
SMALL_REST = 0.05
"""If the unexplained part of a gap is below this fraction of the gap (root mean square), the effect explains nearly all of the
gap."""
WRONG_BY = 2.0
"""The verdict mentions noise that differs from its declaration by more than this factor."""
DEPARTURE = 0.05
"""A difference between the noise and its declaration is reported if it is at least this fraction of the declaration."""
MOST_PLACES = 12
MOST_PARAMETERS = 24
MOST_POINTS = 24
FOOTER = (
    "Probabilities depend on fixed priors and on the noise that the bench declares. An effect is named only if "
    "the probability of “none” is below 5 %; effects that this plan cannot separate are named together."
)
WHERE = "Where the gap is: each factor, such as the orientation or the rate, divides the whole gap. Add up only the shares of one factor"
Data = Mapping[str, Json]


@dataclass(frozen=True)
class DiagnosisContext:
    """The input of the page of a diagnosis.

    `title`: title of the plan. `diagnosis`: the diagnosis as plain data. `facts`: facts about the diagnosed recording. `remarks`:
    warnings about the recording. `next_plan`: text of the proposed plan, empty if there is none. `origin`: whether the samples are
    measured, simulated or played back.
    """

    title: str
    diagnosis: Data
    facts: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    next_plan: str = ""
    origin: DataOrigin | None = None


def render_page(context: DiagnosisContext) -> str:
    """Renders one self-contained HTML page. Raises `ReportError` if the page cannot be rendered."""
    found = context.diagnosis
    given = {
        "title": context.title,
        "facts": named(context.facts),
        "named": named_effects(found),
        "verdict": verdict(found),
        "stamp": stamped(context.origin),
        "reach": " ".join(filter(None, (unknown_words(found), closure_words(found)))),
        "remarks": list(context.remarks),
        "tables": {name: table_view(table) for name, table in tables(found).items()},
        "pictures": pictures(found),
        "expected": expected_words(found),
        "next_plan": context.next_plan,
        "footer": " ".join((FOOTER, priors_words(found))),
    }
    return render("diagnosis.html", given)


@dataclass(frozen=True, slots=True)
class Named:
    """Contains the text about one named effect: a heading that says who must act, then what to do, and the physics."""

    heading: str
    remedy: str
    physics: str


def named_effects(found: Data) -> list[Named]:
    """Returns the named effects in the order of the verdict. If the plan cannot distinguish several effects, only the most probable
    effect is included."""
    open_ = "Most likely, but not certain: " if found["verdict"]["kind"] == "indistinguishable" else ""
    return [
        Named(
            _capital(f"{open_}{one['name']} ({one['effect']}). Where to correct: {one['actor']}."),
            one["remedy"],
            one["physics"],
        )
        for one in found.get("named", [])
    ]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


# -- sentences -------------------------------------------------------------------------------------------------------


def verdict(found: Data) -> str:
    """States the answer of the diagnosis in one sentence. If the noise differs much from its declaration, a second sentence states
    this."""
    return " ".join(filter(None, (_cause(found), *_noise_beside(found), *_noise_declared_wrongly(found))))


def _noise_beside(found: Data) -> list[str]:
    """Returns a sentence about each effect on the noise that acts in addition to the cause of the gap."""
    chances = found.get("noise_effects", {})
    return [
        f"The noise differs from its declaration: {name} ({probability(chances[name])})."
        for name in found["verdict"].get("noise", ())
    ]


def _noise_declared_wrongly(found: Data) -> list[str]:
    """Returns a sentence about each channel whose white noise differs from its declaration by more than a factor of two."""
    factors = {one["channel"]: one["white"] / one["declared"] for one in found.get("noise", ()) if one["declared"]}
    larger = {name: ratio for name, ratio in factors.items() if ratio > WRONG_BY}
    smaller = {name: 1 / ratio for name, ratio in factors.items() if 0 < ratio < 1 / WRONG_BY}
    told = []
    for what, ratios in (("larger", larger), ("smaller", smaller)):
        if ratios:
            low, high = (f"{end(ratios.values()):.2g}" for end in (min, max))
            times = low if low == high else f"{low} to {high}"
            told.append(f"The noise of {listed(list(ratios))} is {what} than declared by a factor of {times}.")
    return told


def _noise_alone(found: Data) -> float:
    """Returns the probability that only noise acts, at its declared level or at another level."""
    levels = {"none", *found.get("noise_effects", ())}
    return min(1.0, float(sum(p for name, p in found["posterior"].items() if levels.issuperset(name.split("+")))))


def _cause(found: Data) -> str:
    """States the cause of the gap in one sentence."""
    said, posterior = found["verdict"], found["posterior"]
    kind, effects = said["kind"], list(said["effects"])
    noise = _noise_alone(found)
    if kind == "none" and noise < SURE:
        return f"No effect is named: noise alone may explain the recording ({probability(noise)})."
    if kind == "none":
        return f"No gap: noise alone explains the recording ({probability(noise)})."
    if kind == "unknown":
        return f"A gap caused by something that the catalogue does not contain ({probability(posterior['unknown'])})."
    names = list(said["class"] or effects) if kind == "indistinguishable" else ["+".join(sorted(effects))]
    either = listed([explanation(name) for name in names], "or")
    residue = said.get("form_residue")
    beside = (
        ["+".join(sorted((*name.split("+"), residue))) for name in names] if residue not in (None, *effects) else []
    )
    hypotheses = {*names, "+".join(sorted(effects)), *beside}
    hypotheses |= {"+".join(sorted({*name.split("+"), "unknown"})) for name in hypotheses - {"unknown"}}
    together = min(1.0, sum(posterior.get(name, 0.0) for name in hypotheses))
    nearly = residue is not None and together < 0.5
    how = _much(found, nearly) + ("" if nearly else f" ({probability(together)})")
    if kind == "indistinguishable" and _open(found):
        chance = "" if nearly else f" (together {probability(together)})"
        beside_it = _something_else(found).replace(" and ", " and by ", 1)
        said_so = f"The gap is caused by {either},{beside_it}: this plan cannot distinguish the named effects{chance}."
    elif kind == "indistinguishable":
        chance = "" if nearly else f" (together {probability(together)})"
        said_so = f"{either} explains {_much(found, nearly)}: this plan cannot distinguish them{chance}."
    elif _open(found):
        chance = "" if nearly else f" ({probability(together)})"
        said_so = f"{', '.join(effects)}{_something_else(found)} cause the gap{chance}."
    else:
        said_so = f"{listed(effects)} {'together explain' if len(effects) > 1 else 'explains'} {how}."
    return said_so + _rest(found) + _remainder(residue, effects)


def _open(found: Data) -> bool:
    """Returns True if the pattern or the size of the residual gap shows that something acts in addition to the named effects."""
    rest = found.get("rest")
    visible = rest is not None and not rest["passes"] and float(rest["share"]) >= SMALL_REST
    return visible or (found["verdict"].get("something_else") is True and not _form(found))


def _form(found: Data) -> bool:
    """Returns True if the residual gap may exist only because the model of a strong effect is idealised."""
    residue: str | None = found["verdict"].get("form_residue")
    return residue == "unknown"


def _something_else(found: Data) -> str:
    rest = found.get("rest")
    if rest is None or not rest.get("sigma"):
        return " and something else"
    channel, sigma = max(rest["sigma"].items(), key=lambda item: item[1])
    return f" and something else of {float(f'{sigma:.2g}'):g} σ on {channel}" if sigma > 0 else " and something else"


def _much(found: Data, nearly: bool) -> str:
    """States in words how much of the gap the named effects explain. If the residual gap is only noise, the named effects explain
    the whole gap."""
    rest = found.get("rest")
    if rest is not None and not rest["passes"]:
        return "nearly all of the gap"
    return "nearly all of the gap" if nearly else "the gap"


def _rest(found: Data) -> str:
    """Returns a sentence about the size of the gap that the named effects leave; empty if this residual gap is only noise."""
    rest = found.get("rest")
    if rest is None or rest["passes"]:
        return ""
    channel, times = max(rest["times_noise"].items(), key=lambda item: item[1])
    size = f"{_percent(rest['share'])} of the gap (root mean square), {times:.3g} times the noise in {channel}"
    if float(times) < 1:
        return f" The rest is smaller than the noise, but it follows a pattern that noise does not have: {size}."
    return f" The rest is not noise: {size}."


def _remainder(residue: str | None, named: list[str]) -> str:
    """Returns a sentence about an additional cause, or about the certainty of the weaker of two effects; empty if neither is
    needed."""
    if residue is None:
        return ""
    if residue in named:
        others = listed([name for name in named if name != residue])
        return (
            f" {residue} explains less than 5 % of the gap: either it is present but weak, or it only makes up for an "
            f"error in the modelled form of {others} (form residue)."
        )
    if residue == "unknown":
        return " The rest comes from something that the catalogue does not contain."
    return (
        f" The contribution of {residue} is below 5 % and is treated as an error of the modelled form (form residue)."
    )


NOT_MEASURED = {
    "no effect": "No effect is named, so the output does not state by how much the gap shrinks.",
    "few segments": "The recording has fewer than six segments, so it cannot show by how much the gap of withheld segments shrinks.",
    "not repeated": (
        "The recording cannot show by how much the gap of withheld segments shrinks, because the other segments contain too little "
        "information about the effect. Repeat the segments that show the effect."
    ),
    "wide": (
        "The recording cannot show by how much the gap of withheld segments shrinks, because the gap is too small compared with the noise."
    ),
}
"""The sentence for each reason why there is no closure, except "random"."""


def closure_words(found: Data) -> str:
    """States in one or two sentences how much the effects reduce or increase the gap, or why this is not known."""
    closure = found["closure"]
    if found["verdict"]["kind"] == "none":
        return "There is no gap to close."
    unpredicted = closure.get("unpredicted", ())
    if closure.get("reason") == "random":
        return (
            f"{listed(unpredicted)} cannot be predicted from other segments, because it is random. Therefore, withheld segments cannot "
            "show by how much the gap shrinks."
        )
    if not closure["resolvable"] or closure["shrinks_by"] is None:
        default = "This recording cannot show by how much the gap of withheld segments shrinks."
        return NOT_MEASURED.get(closure.get("reason"), default) + _repetition_words(closure.get("repetition"))
    text = f"The gap of withheld segments {_change(closure['shrinks_by'])}"
    if closure["interval_90"] is not None:
        text += f" (90 % interval {_interval(*closure['interval_90'])})"
    if closure["before"] is not None and closure["after"] is not None:
        text += f", from {closure['before']:.3g} to {closure['after']:.3g} standard deviations of the noise"
    if unpredicted:
        text += f". The gap that remains includes {listed(unpredicted)}, which is random and cannot be predicted from other segments"
    return text + "."


def _repetition_words(repetition: Data | None) -> str:
    """States the expected change of the gap in a repetition of the same segments; empty if this change is not known."""
    if repetition is None:
        return ""
    text = f" In a repetition of the same segments, the gap {_change(repetition['shrinks_by'])}"
    return f"{text} (90 % interval {_interval(*repetition['interval_90'])}) if the named effects are added to the simulation."


def expected_words(found: Data) -> str:
    """States in one sentence what to measure next."""
    following = found["next"]
    if following is None:
        return ""
    expected = following["expected"]
    if isinstance(expected, Mapping) and "words" in expected:
        return str(expected["words"])
    if isinstance(expected, Mapping):
        return "; ".join(f"{name.replace('_', ' ')}: {_plain(value)}" for name, value in expected.items())
    return _plain(expected)


def priors_words(found: Data) -> str:
    """States the prior probabilities on which the result is based, if the diagnosis contains them."""
    listed = [f"{name} {p:.2f}" for name, p in found.get("priors", {}).items()]
    return f"Priors: {', '.join(listed)}." if listed else ""


def probability(p: float) -> str:
    """Returns a probability as text. It has three decimals near 0 and 1, and two decimals otherwise. Below 0.001 and above 0.999, it
    is written as a bound."""
    if p > 0.999:
        return "P > 0.999"
    return "P < 0.001" if p < 0.001 else f"P = {p:.3f}" if p > 0.99 or p < 0.01 else f"P = {p:.2f}"


# -- tables ----------------------------------------------------------------------------------------------------------


def tables(found: Data) -> dict[str, Table]:
    """Returns the tables of a diagnosis by name; empty tables are omitted."""
    made = {
        "comparison": comparison(found),
        "unknown_form": _unknown_form(found),
        "gap": _gap(found),
        "closure": _closure(found),
        "noise": _noise(found),
        "where": _where(found),
        "hypotheses": _hypotheses(found),
        "parameters": _parameters(found),
        "absorbed": _absorbed(found),
    }
    return {name: table for name, table in made.items() if table.rows}


def unknown_words(found: Data) -> str:
    """Describes the unknown cause in one sentence; empty if the form of the cause is not known."""
    form = found.get("unknown_form")
    if not form:
        return ""
    share = "" if form["share"] is None else f" and makes up {_percent(form['share'])} of the energy of the gap"
    where = f"in {listed(form['channels'])}"
    return f"The cause outside the catalogue looks like “{form['pattern']}” {where}. It changes with {form['factor']}{share}."


def _unknown_form(found: Data) -> Table:
    form = found.get("unknown_form") or {"points": [], "channels": [], "units": [], "factor": ""}
    points = form["points"][:MOST_POINTS]
    rows = tuple(
        (
            one["level"],
            *(
                _short(value)
                for pair in zip(one["values"], one["standard_uncertainties"], strict=True)
                for value in pair
            ),
        )
        for one in points
    )
    left = len(form["points"]) - len(points)
    names = [f"{name} [{unit}]" for name, unit in zip(form["channels"], form["units"], strict=True)]
    if left > 0:
        rows = (*rows, (f"and {left} more, in the diagnosis as JSON", *[""] * (2 * len(names))))
    columns = [
        column for name in names for column in (*alike(Role.VALUE, name), *alike(Role.STANDARD_UNCERTAINTY, "u"))
    ]
    return Table(
        "Form of the cause outside the catalogue", (*alike(Role.LABEL, form["factor"] or "level"), *columns), rows
    )


def _gap(found: Data) -> Table:
    columns: tuple[Shown[tuple[str, Data]], ...] = (
        Shown(TableColumn("Channel"), lambda item: item[0]),
        Shown(TableColumn("gap", Role.VALUE), lambda item: _short(item[1]["before"])),
        Shown(TableColumn("for noise alone", Role.VALUE), lambda item: _short(item[1]["noise_floor"])),
        Shown(TableColumn("times noise", Role.VALUE), lambda item: _times(item[1]["before"], item[1]["noise_floor"])),
        Shown(TableColumn("Unit"), lambda item: item[1]["unit"]),
    )
    return table_of("Gap by channel", columns, list(found["gap"].items()))


def _closure(found: Data) -> Table:
    """Returns a table of the gap without and with the effect. The table has one row for each channel whose data determine the
    gap."""
    columns: tuple[Shown[Data], ...] = (
        Shown(TableColumn("Channel"), lambda one: one["channel"]),
        Shown(TableColumn("before [σ]", Role.VALUE), lambda one: _short(one["before"])),
        Shown(TableColumn("after [σ]", Role.VALUE), lambda one: _short(one["after"])),
        Shown(TableColumn("before", Role.VALUE), lambda one: _short(one["before_value"])),
        Shown(TableColumn("after", Role.VALUE), lambda one: _short(one["after_value"])),
        Shown(TableColumn("Unit"), lambda one: one["unit"]),
        Shown(TableColumn("shrinks by", Role.VALUE), lambda one: _percent(one["shrinks_by"])),
        Shown(TableColumn("90 % interval", Role.VALUE), lambda one: " to ".join(map(_percent, one["interval_90"]))),
    )
    title = "Gap of withheld segments without and with the effect"
    return table_of(title, columns, found["closure"].get("channels", ()))


def comparison(found: Data) -> Table:
    """Returns a table of the gap in each channel between the recording and the simulation, without and with the effects found;
    empty if the diagnosis contains no comparison."""
    channels = (found.get("comparison") or {}).get("channels", {})
    rows = tuple(
        (
            name,
            *(_short(one[key]) for key in ("before", "after", "noise")),
            one["unit"],
            *(f"{one[key]:.3g}" for key in ("before_sigma", "after_sigma")),
            *(_short(one["sample_noise"][key]) for key in ("recorded", "before", "after")),
        )
        for name, one in channels.items()
    )
    return Table(
        "Recording against simulation, without and with the effects found",
        (
            TableColumn("Channel"),
            *alike(Role.VALUE, "gap without", "with", "noise alone"),
            TableColumn("Unit"),
            *alike(Role.VALUE, "σ without", "σ with"),
            *alike(Role.VALUE, "sample noise recorded", "without", "with"),
        ),
        rows,
    )


def _noise(found: Data) -> Table:
    """Returns a table of the channels whose noise is not white, not as declared, or not equal in all segments."""
    rows = tuple(
        (one["channel"], one["unit"], *entries) for one in found.get("noise", ()) if any(entries := _departures(one))
    )
    titles = ("white noise", "count", "slow noise ÷ white", "in the segments ÷ white", "tone")
    return Table(
        "Noise that differs from white noise as declared",
        (TableColumn("Channel"), TableColumn("Unit"), *alike(Role.VALUE, *titles)),
        rows,
    )


def _departures(noise: Data) -> tuple[str, str, str, str, str]:
    """Returns the five values that describe the noise of a channel, as texts. The text of a value that is as expected is empty."""
    white, declared, count, line = noise["white"], noise["declared"], noise["count"], noise["line"]
    ratio = white / declared if declared else 1.0
    other_count = not math.isclose(count, noise["declared_count"], rel_tol=0.01, abs_tol=1e-300)
    return (
        "" if abs(ratio - 1) < DEPARTURE else f"{_short(white)} ({ratio:.2g} × declared)",
        f"{_short(count)}" if count and other_count else "",
        "" if abs(noise["slow"] - 1) < DEPARTURE else f"{noise['slow']:.2g}",
        ""
        if noise["loudest"] - noise["quietest"] < DEPARTURE
        else f"{noise['quietest']:.2g} to {noise['loudest']:.2g}",
        "" if line is None else f"{_short(line['amplitude'])} at {line['frequency']:.4g} Hz",
    )


def _where(found: Data) -> Table:
    columns: tuple[Shown[Data], ...] = (
        Shown(TableColumn("Channel"), lambda one: one["channel"]),
        Shown(TableColumn("factor"), lambda one: _spaced(one["factor"])),
        Shown(TableColumn("level"), lambda one: _plain(one["level"])),
        Shown(TableColumn("share of the gap", Role.SHARE), _share_of_gap),
        Shown(TableColumn("p", Role.VALUE), lambda one: _p(one["p"])),
    )
    return table_of(WHERE, columns, [one for one in found["where"][:MOST_PLACES] if one["p"] < CONSPICUOUS])


def _share_of_gap(one: Data) -> str:
    return f"{_percent(one['share'])} of the noise" if one.get("of") == "noise" else _percent(one["share"])


def _hypotheses(found: Data) -> Table:
    columns: tuple[Shown[tuple[str, float]], ...] = (
        Shown(TableColumn("Hypothesis"), lambda item: item[0].replace("+", " + ")),
        Shown(TableColumn("probability", Role.VALUE), lambda item: f"{item[1]:.3f}"),
        Shown(TableColumn("in the 95 % set"), lambda item: "yes" if item[0] in found["ambiguity_set"] else ""),
    )
    return table_of("Which effect", columns, ranked(found))


def _parameters(found: Data) -> Table:
    rows = tuple(
        (one["effect"], one["name"], _short(one["value"]), _short(one["standard_uncertainty"]), one["unit"])
        for one in found["parameters"][:MOST_PARAMETERS]
    )
    left = len(found["parameters"]) - len(rows)
    if left > 0:
        rows = (*rows, (f"and {left} more, in the diagnosis as JSON", "", "", "", ""))
    return Table(
        "Fitted parameters of the effect",
        (
            *alike(Role.LABEL, "Effect", "parameter"),
            *alike(Role.VALUE, "value"),
            *alike(Role.STANDARD_UNCERTAINTY, "u"),
            *alike(Role.LABEL, "Unit"),
        ),
        rows,
    )


def _absorbed(found: Data) -> Table:
    columns: tuple[Shown[Data], ...] = (
        Shown(TableColumn("Effect"), lambda one: one["effect"]),
        Shown(TableColumn("remaining share of its energy", Role.SHARE), lambda one: _percent(one["kept_share"])),
    )
    return table_of("Absorbed by the fitted nominal parameters", columns, found["absorbed"])


# -- words -----------------------------------------------------------------------------------------------------------


def _percent(share: float | None) -> str:
    if share is None:
        return "–"
    if 0 <= share < 0.001:
        return "< 0.1 %"
    if abs(share) < 0.1:
        return f"{100 * share:.2g} %"
    return f"{100 * share:.0f} %" if share < 0.985 else f"{100 * share:.1f} %"


def _change(shrinks_by: float) -> str:
    return f"shrinks by {_percent(shrinks_by)}" if shrinks_by >= 0 else f"grows by {_percent(-shrinks_by)}"


def _interval(low: float, high: float) -> str:
    """Returns the interval of the relative change of a gap as text, with the smaller value first. Words are used if the interval
    includes both reduction and growth."""
    if low >= 0:
        return f"{_percent(low)} to {_percent(high)}"
    if high <= 0:
        return f"{_percent(-high)} to {_percent(-low)}"
    return f"it {_change(low)} to it {_change(high)}"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def _short(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def _times(before: float | None, floor: float | None) -> str:
    return "–" if not before or not floor else f"{before / floor:.3g}"


def _spaced(text: str) -> str:
    return text.replace("_", " ")


def _plain(value: Json) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return ", ".join(_plain(item) for item in value)
    return str(value)


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
        yield (
            "Effects that this plan cannot clearly distinguish",
            words,
            False,
            confusability_svg(alike, "confusability"),
        )
    form: Data = found.get("unknown_form") or {}
    for place, name in enumerate(form.get("channels", [])[:MOST_CHANNELS] if form.get("points") else []):
        words = (
            "Offsets that the simulation and its fitted parameters do not explain, with their standard uncertainties."
        )
        yield f"Form of the unknown in {name}", words, False, plot_svg(_form_picture(form, place), f"form-{_key(name)}")
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


def _form_picture(form: Data, place: int) -> Plot:
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
        described = (
            f"The largest gap is {values[row, column]:.3g} times the noise: {channels[row]} in '{segments[column]}'."
        )
        title = f"Gap of {count_of(len(channels), 'channel')} over {count_of(len(segments), 'segment')}"
        return save(key, title, described)


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
