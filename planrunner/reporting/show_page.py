"""Makes the `show` page of a schedule before it runs: its timeline, a picture of every orientation, and the predicted
uncertainties."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from planrunner.base.documents import JsonObject, finite
from planrunner.base.findings import count_of
from planrunner.estimators.interface import Coefficient, Design
from planrunner.estimators.tables import Role, Shown, Table, TableColumn, table_of
from planrunner.plan.schedule import Rest, Schedule, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS
from planrunner.reporting import words
from planrunner.reporting.orientations import orientation_svg
from planrunner.reporting.templates import render
from planrunner.reporting.timeline import spans
from planrunner.reporting.view import coefficient_row, named, table_view

MAX_PICTURES = 200
MAX_BARS = 5000
MOST_LABELS = 4  # in a short list
_IDLE = ("–", "0")
"""Contents of cells without information. A column that contains only such cells is left out."""


@dataclass(frozen=True, slots=True)
class ShowContext:
    """Contains a schedule and its expected results. `designs`: maps each estimate to its design, whose `predicted` coefficients
    have the expected standard uncertainties.
    """

    title: str
    schedule: Schedule
    description: str = ""
    designs: Mapping[str, Design] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    probability: float = 0.95


def render_show(context: ShowContext) -> str:
    """Renders one self-contained HTML page. The same context gives the same text. Raises `ReportError` if the page cannot be
    rendered."""
    return render("show.html", show_view(context))


def show_view(context: ShowContext) -> JsonObject:
    """Returns the data for the template of the page: title, description, facts, timeline (SVG), segments, pictures, predictions and
    others."""
    from markupsafe import Markup

    from planrunner.reporting.plots import timeline_svg

    schedule = context.schedule
    drawn = 0 < len(schedule.segments) <= MAX_BARS
    groups = orientations(schedule.segments)
    pictures = [
        {
            "svg": Markup(orientation_svg(group[0].attitude, group[0].label)),
            "labels": labels_in_short([item.label for item in group]),
            "words": words.orientation(group[0]),
        }
        for group in groups[:MAX_PICTURES]
    ]
    hidden = len(groups) - len(pictures)
    return {
        "title": context.title,
        "description": context.description,
        "facts": named({**context.facts, **totals(schedule)}),
        "timeline": Markup(timeline_svg(schedule, "timeline")) if drawn else "",
        "segments": table_view(timeline_table(schedule)),
        "pictures": pictures,
        "more_pictures": f"Not shown here: {count_of(hidden, 'more orientation')}." if hidden > 0 else "",
        "predictions": [
            {
                "name": name,
                "coefficients": predicted_rows(design.predicted, context.probability),
                "notes": list(design.all_notes),
            }
            for name, design in context.designs.items()
        ],
        "warnings": list(context.warnings),
        "notes": list(context.notes),
        "provenance": named(context.provenance),
        "probability_percent": words.number(100 * context.probability),
    }


def show_json(schedule: Schedule, designs: Mapping[str, Design]) -> JsonObject:
    """Returns a schedule and its expected results as plain JSON data. The keys are total_s, segments, and predicted, which has one
    entry for each estimate. Keys name the units of their values. The value None means that the plan does not specify the
    quantity."""
    return {
        "total_s": schedule.total,
        "segments": [_segment_json(item) for item in schedule.segments],
        "predicted": {
            name: [
                {
                    "name": item.name,
                    "nominal": item.value,
                    "unit": item.unit,
                    "standard_uncertainty": finite(item.standard_uncertainty),
                }
                for item in design.predicted
            ]
            for name, design in designs.items()
        },
    }


def _segment_json(item: Segment) -> JsonObject:
    return {
        "index": item.index + 1,
        "label": item.label,
        "start_s": item.start,
        "transition_s": item.transition,
        "soak_s": item.soak,
        "settle_s": item.settle,
        "dwell_s": item.dwell,
        "orientation": words.orientation(item),
        "attitude": None if item.attitude is None else item.attitude.tolist(),
        "motion": words.motion(item.motion),
        "rate_deg_per_s": math.degrees(item.rate),
        "temperature_degC": None if item.temperature is None else item.temperature - ZERO_CELSIUS,
        "supply_V": item.supply_voltage,
        "pressure_Pa": item.ambient_pressure,
        "ramp_to_degC": None if item.ramp_to is None else item.ramp_to - ZERO_CELSIUS,
    }


def predicted_rows(coefficients: Sequence[Coefficient], probability: float) -> list[dict[str, str]]:
    return [coefficient_row(item, probability) for item in coefficients]


def totals(schedule: Schedule) -> dict[str, str]:
    """Returns the total times and counts of a schedule."""
    segments = schedule.segments
    recorded = sum(item.dwell or 0.0 for item in segments)
    settling = sum(item.waiting for item in segments)
    unknown = any(item.dwell is None for item in segments)
    facts = {
        "total time": words.duration(schedule.total) + (" plus the length of the recordings" if unknown else ""),
        "segments": str(len(segments)),
        "recording": words.duration(recorded) + (" plus the length of the recordings" if unknown else ""),
        "soaking and settling": words.duration(settling),
        "moving and changing temperature": words.duration(sum(item.transition for item in segments)),
        "orientations": str(len(orientations(segments))),
    }
    if len(set(map(words.orientation, segments))) == 1:
        facts["orientations"] += f" ({words.orientation(segments[0])})"
    held = [t for item in segments for t in (item.temperature, item.ramp_to) if t is not None]
    if held:
        low, high = words.celsius(min(held)), words.celsius(max(held))
        facts["temperature"] = f"{low} °C" if low == high else f"{low} °C to {high} °C"
    rates = [abs(item.rate) for item in segments if item.rate]
    if rates:
        low, high = (words.number(round(float(np.degrees(value)), 9)) for value in (min(rates), max(rates)))
        facts["rates"] = f"±{high} °/s" if low == high else f"{low} to {high} °/s in both directions"
    return facts


def orientations(segments: Sequence[Segment]) -> list[list[Segment]]:
    """Groups segments with the same attitude, in the order in which the attitudes are first used."""
    groups: dict[object, list[Segment]] = {}
    for item in segments:
        key = None if item.attitude is None else tuple(np.round(item.attitude, 7).ravel() + 0.0)
        groups.setdefault(key, []).append(item)
    return list(groups.values())


def labels_in_short(labels: Sequence[str]) -> str:
    """Returns a list of labels in short form: `P6, T3`, or `P6, P7, P8 and 5 more`."""
    distinct = list(dict.fromkeys(labels))
    if len(distinct) <= MOST_LABELS:
        return ", ".join(distinct)
    return f"{', '.join(distinct[: MOST_LABELS - 1])} and {len(distinct) - MOST_LABELS + 1} more"


def timeline_table(schedule: Schedule, brief: bool = False) -> Table:
    """Returns a table with one row for each segment: start, transition, state, duration. Columns without information are omitted.

    `brief`: True to make the table narrow enough for a terminal. Soaking and settling then share a column, and the end time is left
    out. If there is only one orientation, the column of orientations is left out as well.
    """
    segments = schedule.segments
    ends = {span.segment.index: words.clock(span.end) for span in spans(schedule) if span.segment.dwell is not None}
    turned = len(set(map(words.orientation, segments))) > 1
    columns: list[Shown[Segment]] = [
        Shown(TableColumn("#", Role.COUNT), lambda item: str(item.index + 1)),
        Shown(TableColumn("Start", Role.NUMBER, "" if brief else "h:mm:ss"), lambda item: words.clock(item.start)),
        Shown(TableColumn("Segment"), lambda item: item.label),
        *([Shown(TableColumn("Orientation"), words.orientation)] if turned or not brief else []),
        *_motion_columns(segments, brief),
        Shown(TableColumn("T" if brief else "Temperature", Role.NUMBER, "°C"), words.temperature, ("–",)),
        Shown(TableColumn("Supply", Role.NUMBER, "V"), words.supply, ("–",)),
        Shown(TableColumn("Pressure", Role.NUMBER, "hPa"), words.pressure, ("–",)),
        Shown(TableColumn("Reach", Role.NUMBER, "s"), lambda item: words.number(round(item.transition, 1))),
        *(_WAIT if brief else _SOAK_AND_SETTLE),
        Shown(TableColumn("Dwell"), lambda item: words.duration(item.dwell)),
    ]
    if not brief:
        columns.append(Shown(TableColumn("End", Role.NUMBER, "h:mm:ss"), lambda item: ends.get(item.index, "–")))
    return table_of("Segments in order", columns, segments)


_WAIT: tuple[Shown[Segment], ...] = (
    Shown(TableColumn("Wait", Role.NUMBER, "s"), lambda item: words.number(item.waiting), _IDLE),
)
_SOAK_AND_SETTLE: tuple[Shown[Segment], ...] = (
    Shown(TableColumn("Soak", Role.NUMBER, "s"), lambda item: words.number(item.soak), _IDLE),
    Shown(TableColumn("Settle", Role.NUMBER, "s"), lambda item: words.number(item.settle), _IDLE),
)


def _motion_columns(segments: Sequence[Segment], brief: bool) -> list[Shown[Segment]]:
    """Returns the columns that show the motion. If all segments are at rest, there is no column. If all motions are rates about one
    direction, the column contains numbers; otherwise, it contains words."""
    moving = [item.motion for item in segments if not isinstance(item.motion, Rest)]
    if not moving:
        return []
    abouts = {item.about if isinstance(item, Spin) else None for item in moving}
    about = abouts.pop()
    if not abouts and about is not None:
        title = "Rate" if brief else f"Rate about {words.direction(about)}"
        return [Shown(TableColumn(title, Role.NUMBER, "°/s"), words.rate)]
    return [Shown(TableColumn("Motion"), lambda item: words.motion(item.motion))]
