"""Makes the output of a diagnosis of several runs: sentences and tables for the terminal, and one page.

The input is plain data according to `schemas/fleet.schema.json`. Only rounded numbers are computed here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from planrunner.base.documents import Json
from planrunner.base.findings import count_of
from planrunner.estimators.tables import Plot, Role, Shown, Table, TableColumn, alike, table_of
from planrunner.instruments.models import DataOrigin
from planrunner.reporting.diagnosis_page import probability
from planrunner.reporting.rounding import format_pair
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, stamped, table_view
from planrunner.reporting.words import behind_number, listed

Data = Mapping[str, Json]
MOST_PARTS = 5
"""Maximum number of parts of one source that sentences state. The JSON output contains all parts."""
MOST_PLOTS = 12
POSSIBLE = 0.2
"""The table of amplitudes also mentions a source that the verdict does not name, if its probability is at least this value. The
JSON output contains all sources."""
PRIORS = (
    "Each source contributes to an amplitude with a prior probability of 1/2, independently of the others. A source is named at a "
    "probability of 0.95 or more, and excluded below 0.05. ± U is the half-width of a 95 % interval."
)
_SOURCES = ("device", "bench", "occasion", "common")
_WORDS = {"device": "device", "bench": "bench", "occasion": "occasion", "common": "what all runs have in common"}
_REMEDY = {
    frozenset(("device", "bench")): "measure several devices on one bench, or one device on several benches",
    frozenset(("device", "common")): "measure a second device",
    frozenset(("bench", "common")): "measure on a second bench",
    frozenset(("device", "occasion")): "measure each device again after it was switched off and on",
    frozenset(("bench", "occasion")): "measure several times on each bench",
}


def sentences(found: Data) -> list[str]:
    """Returns sentences about changes and their times, about properties that the devices of a lot have in common, and about the
    sources to which effects are attributed."""
    return [*news(found), *(text for amplitude in found["amplitudes"] for text in _of_amplitude(found, amplitude))]


def statements(found: Data) -> list[str]:
    """Returns all sentences except those about terms that the simulation fits, because it is normal that every device has its own
    bias."""
    beside = [one for one in found["amplitudes"] if one["effect"] not in found["nominal"]]
    return [*news(found), *(text for amplitude in beside for text in _of_amplitude(found, amplitude))]


def news(found: Data) -> list[str]:
    """Returns only the sentences about changes and their times, and about properties that the devices of a lot have in common."""
    changed = [_of_change(one, change) for one in found["amplitudes"] for change in one["changes"]]
    return [*changed, *map(_of_lot, found["shared"])]


def _of_change(amplitude: Data, change: Data) -> str:
    """States a change of an amplitude, as in `bench b2: table_tilt about_east changed by 4.0 ± 0.5 arcsec between …`."""
    names = [
        _WORDS[source] if source == "common" else f"{_WORDS[source]} {label}" for source, label in change["sources"]
    ]
    value, u = format_pair(change["size"], change["expanded_uncertainty"])
    label = f"{amplitude['effect']} {amplitude['name']}"
    after, until = _minute(change["after"]), _minute(change["until"])
    size = f"{value} ± {u}{behind_number(change['unit'])}"
    p = "p < 0.001" if change["p"] < 0.001 else f"p = {change['p']:.2g}"
    if change["kind"] == "drift":
        return f"{' or '.join(names)}: {label} drifts by {size} from {after} to {until} UTC ({count_of(change['runs_after'], 'run')}, {p})."
    counts = f"{count_of(change['runs_before'], 'run')} before, {change['runs_after']} since, {p}"
    return f"{' or '.join(names)}: {label} changed by {size} between {after} and {until} UTC ({counts})."


def _minute(moment: object) -> str:
    """Shortens a moment in ISO 8601 to minutes, such as `2026-03-03 22:14`."""
    return str(moment)[:16].replace("T", " ")


def _of_lot(one: Data) -> str:
    value, u = format_pair(one["difference"], one["expanded_uncertainty"])
    devices = f"{count_of(len(one['devices']), 'device')} of lot {one['lot']} ({', '.join(one['devices'])})"
    apart = f"{value} ± {u}{behind_number(one['unit'])} from the {one['others']} others"
    return f"{devices} share {one['effect']} {one['name']}: {apart} (by chance: {one['chance']:.2g})."


def _of_amplitude(found: Data, amplitude: Data) -> Iterator[str]:
    label, unit = f"{amplitude['effect']} {amplitude['name']}", behind_number(amplitude["unit"])
    for one in amplitude["contributions"]:
        sources = one["sources"]
        if sources not in amplitude["named"] or (amplitude["effect"] in found["nominal"] and sources == ["common"]):
            continue
        chance = probability(one["probability"])
        if "occasion" in sources and len(one["parts"]) > 1:
            what = "changes at each switch-on" if sources == ["occasion"] else "differs from run to run"
            low, high = (f"{limit:.2g}" for limit in one["interval_95"])
            spread = f"{one['standard_deviation']:.2g}{unit} (1 σ, 95 % interval {low} to {high}; {chance})"
            either = "" if len(sources) == 1 else f"; {_either(sources)}"
            yield f"{label} {what}, {spread}{either}."
            continue
        clear = sorted((part for part in one["parts"] if _clear(part) > 1), key=lambda part: -_clear(part))
        for part in clear[:MOST_PARTS]:
            size = _with_u(part["level"] or part["part"], unit)
            others = "the mean of the others" if len(one["parts"]) > 2 else "the other"
            apart = f", {_with_u(part['difference'], unit)} from {others}" if part["difference"] else ""
            yield f"{_who(found, sources, part)}: {label} {size}{apart} ({_count(sources, part)}{chance})."
        if len(clear) > MOST_PARTS:
            kind = _WORDS[sources[0]]
            yield f"{label}: the JSON output contains {count_of(len(clear) - MOST_PARTS, 'more value')} for a single {kind}."


def _clear(part: Data) -> float:
    """Returns a measure of how clear a part is: the difference from the other parts, divided by the expanded uncertainty of this
    difference. If there are no other parts, returns the value of the part divided by its expanded uncertainty."""
    one = part["difference"] or part["part"]
    return abs(float(one["value"])) / float(one["expanded_uncertainty"])


def _with_u(one: Data, unit: str) -> str:
    value, u = format_pair(one["value"], one["expanded_uncertainty"])
    return f"{value} ± {u}{unit}"


def _who(found: Data, sources: Sequence[str], part: Data) -> str:
    """Returns the name of a source, such as `bench bench-2`, `bench bench-2 since 2026-03-03 22:14 UTC`, or `bench bench-2, or what
    all runs have in common`."""
    if list(sources) == ["common"]:
        return "all runs"
    run = next(run for run in found["runs"] if run[sources[0]] == part["label"])
    words = [_WORDS[name] if name == "common" else f"{_WORDS[name]} {run[name]}" for name in sources]
    since = f" since {_minute(part['since'])} UTC" if part["since"] else ""
    return ", or ".join(words) + since


def _count(sources: Sequence[str], part: Data) -> str:
    """Returns the number of runs that belong to a part and, if the part is a bench, the number of devices."""
    runs = f"{count_of(part['runs'], 'run')}, "
    if list(sources) != ["bench"]:
        return runs
    return f"{runs}{count_of(part['devices'], 'device')}, "


def _either(sources: Sequence[str]) -> str:
    return f"{listed([_WORDS[name] for name in sources])} cannot be distinguished"


def limits(found: Data) -> list[str]:
    """Returns the sources that the runs cannot distinguish, with the amplitudes concerned and the measurements that would
    distinguish them."""
    concerned: dict[tuple[str, ...], list[str]] = {}
    for amplitude in found["amplitudes"]:
        for one in amplitude["contributions"]:
            if len(one["sources"]) > 1:
                concerned.setdefault(tuple(one["sources"]), []).append(f"{amplitude['effect']} {amplitude['name']}")
    every = len(found["amplitudes"])
    texts = []
    for sources, labels in concerned.items():
        more = f" and {len(labels) - MOST_PARTS} more" if len(labels) > MOST_PARTS else ""
        which = "any amplitude" if len(labels) == every else ", ".join(labels[:MOST_PARTS]) + more
        remedies = [text for pair, text in _REMEDY.items() if pair <= set(sources)]
        why = _alone(found, sources)
        texts.append(f"{why}: {_either(sources)} for {which}. To distinguish them, {'; '.join(remedies)}.")
    texts += [f"{one['effect']} is not attributed: {one['reason']}." for one in found["not_attributed"]]
    return texts


def _alone(found: Data, sources: Sequence[str]) -> str:
    """Returns the reason why some sources cannot be distinguished, such as `One bench only`."""
    if "common" in sources:
        return f"One {' and one '.join(name for name in sources if name != 'common')} only"
    if "occasion" in sources:
        return f"One run for each {' and '.join(name for name in sources if name != 'occasion')}"
    return f"One {sources[0]} for each {sources[1]}"


def tables(found: Data) -> dict[str, Table]:
    """Returns the tables of the attribution and of the runs."""
    return {"attribution": _attribution(found), "runs": _runs(found)}


def _attribution(found: Data) -> Table:
    rows = tuple(
        (
            one["effect"],
            one["name"],
            str(len(one["estimates"])),
            *(_share(one, source) for source in _SOURCES),
            _verdict(one),
        )
        for one in found["amplitudes"]
    )
    return Table(
        "Shares of the mean square of each amplitude over the runs",
        (
            *alike(Role.LABEL, "Effect", "amplitude"),
            *alike(Role.VALUE, "runs", *_SOURCES),
            *alike(Role.LABEL, "verdict"),
        ),
        rows,
    )


def _share(amplitude: Data, source: str) -> str:
    """Returns the share of a source in an amplitude, in percent. The share is marked as an upper bound if other sources group the
    runs in the same way."""
    one = next(one for one in amplitude["contributions"] if source in one["sources"])
    shown = f"{100 * one['share']:.0f} %"
    return shown if len(one["sources"]) == 1 else f"≤ {shown}"


def _verdict(amplitude: Data) -> str:
    chances = {tuple(one["sources"]): one["probability"] for one in amplitude["contributions"]}
    certain = [f"{' or '.join(one)} ({probability(chances[tuple(one)])})" for one in amplitude["named"]]
    unsure = [
        f"{' or '.join(one)} ({probability(chances[tuple(one)])})"
        for one in amplitude["open"]
        if chances[tuple(one)] >= POSSIBLE
    ]
    if not certain and not amplitude["open"]:
        return f"as simulated ({probability(amplitude['none'])})"
    said = " and ".join(certain) or f"no source named (as simulated: {probability(amplitude['none'])})"
    return said + (f"; possible: {', '.join(unsure)}" if unsure else "")


def _runs(found: Data) -> Table:
    columns: tuple[Shown[Data], ...] = (
        Shown(TableColumn("Run"), lambda run: Path(str(run["run"])).name),
        Shown(TableColumn("device"), lambda run: run["device"]),
        Shown(TableColumn("bench"), lambda run: run["bench"]),
        Shown(TableColumn("occasion"), lambda run: run["occasion"]),
        Shown(TableColumn("diagnosis of this run"), lambda run: ", ".join(run["effects"]) or run["verdict"]),
    )
    return table_of("Runs", columns, found["runs"])


def plots(found: Data) -> list[Plot]:
    """Makes plots of the estimated effects, without the nominal terms, and of the amplitudes that a device, bench or occasion
    changes."""
    fitted = set(found["effects"])
    chosen = [
        one
        for one in found["amplitudes"]
        if one["effect"] in fitted or any(list(sources) != ["common"] for sources in one["named"])
    ]
    names = {run["run"]: f"{number}: {run['device']} on {run['bench']}" for number, run in enumerate(found["runs"], 1)}
    return [
        Plot(
            f"{one['effect']} {one['name']}",
            "run: device on bench",
            one["unit"],
            tuple(names[item["run"]] for item in one["estimates"]),
            {"estimate": tuple(item["value"] for item in one["estimates"])},
            {"estimate": tuple(item["standard_uncertainty"] for item in one["estimates"])},
        )
        for one in sorted(chosen, key=lambda one: one["effect"] not in fitted)[:MOST_PLOTS]
    ]


def facts(found: Data) -> dict[str, str]:
    """Returns the numbers that describe the fleet."""
    counts = {name: len({run[name] for run in found["runs"]}) for name in ("device", "bench", "occasion")}
    return {
        "Runs": str(len(found["runs"])),
        "Devices": str(counts["device"]),
        "Benches": str(counts["bench"]),
        "Occasions": str(counts["occasion"]),
        "Plans": "; ".join(dict.fromkeys(str(run["plan"]) for run in found["runs"])),
        "Fitted by the simulation": ", ".join(found["nominal"]) or "nothing",
        "Effects fitted in every run": ", ".join(found["effects"]) or "none",
    }


def render_page(found: Data, remarks: Sequence[str] = (), origin: DataOrigin | None = None) -> str:
    """Renders one self-contained HTML page. `remarks`: warnings about the recordings. `origin`: whether the samples are measured,
    simulated or played back. Raises `ReportError` if the page cannot be rendered."""
    from markupsafe import Markup

    from planrunner.reporting.plots import plot_svg

    given = {
        "title": "Device, bench or occasion",
        "facts": named(facts(found)),
        "sentences": sentences(found),
        "limits": limits(found),
        "stamp": stamped(origin),
        "remarks": list(remarks),
        "tables": [table_view(table) for table in tables(found).values()],
        "plots": [
            {"title": plot.title, "svg": Markup(plot_svg(plot, f"plot-{number}"))}
            for number, plot in enumerate(plots(found), start=1)
        ],
        "footer": PRIORS,
    }
    return render("fleet.html", given)
