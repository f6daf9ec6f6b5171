"""Makes the page on which a run is reviewed for sign-off: deviations first, then limits, results, segments and the digests of all
files.

Every number links to its origin: a limit to its estimate, a coefficient to its budget, an estimate to its segments, and a segment to the
digests of its files. The page is self-contained; the wording is in `templates/review.html.j2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planrunner.base.documents import JsonObject
from planrunner.reporting import words
from planrunner.reporting.context import ReportContext, SegmentSummary
from planrunner.reporting.templates import render
from planrunner.reporting.view import report_view


@dataclass(frozen=True, slots=True)
class RunDeviation:
    """A deviation of the run that a reviewer must judge.

    `kind`: kind of the deviation in words. `segment`: label of the affected segment, if any. `estimate`: name of the affected
    estimate, if any. `grave`: True if the deviation prevents the release of the run.
    """

    kind: str
    text: str
    segment: str = ""
    estimate: str = ""
    grave: bool = False


@dataclass(frozen=True, slots=True)
class DigestedFile:
    """A file of the run folder. `segment`: label of the segment whose samples the file contains. `size`: number of bytes; None if
    it was not recorded."""

    name: str
    sha256: str
    segment: str = ""
    size: int | None = None


@dataclass(frozen=True, slots=True)
class ReviewContext:
    """The input of the review page. `report`: the input for a report of the analysis. `events`: unusual events, each as (UTC time,
    kind, text)."""

    report: ReportContext
    deviations: tuple[RunDeviation, ...]
    files: tuple[DigestedFile, ...]
    events: tuple[tuple[str, str, str], ...] = ()


def render_review(context: ReviewContext) -> str:
    """Renders one self-contained HTML page. Raises `ReportError` if the page cannot be rendered."""
    view = report_view(context.report)
    anchors = {item["name"]: item["anchor"] for item in view["estimates"]}
    places = {item.segment.label: f"s{number}" for number, item in enumerate(context.report.segments, 1)}
    for item in view["estimates"]:
        for number, budget in enumerate(item["budgets"], 1):
            budget["anchor"] = f"{item['anchor']}-b{number}"
        found = {budget["coefficient"]: budget["anchor"] for budget in item["budgets"]}
        item["rows"] = [
            {**row, "budget": found.get(row["name"], "")} for row in (*item["coefficients"], *item["others"])
        ]
        item["places"] = [{"label": label, "anchor": places.get(label, "")} for label in item["segments"]]
    for limit in view["limits"]:
        limit["anchor"] = anchors.get(str(limit["quantity"]).partition(".")[0], "")
    view["deviations"] = [
        {
            "kind": one.kind,
            "text": one.text,
            "grave": one.grave,
            "where": one.segment or one.estimate,
            "anchor": places.get(one.segment, "") if one.segment else anchors.get(one.estimate, ""),
        }
        for one in context.deviations
    ]
    view["grave"] = sum(one.grave for one in context.deviations)
    view["recorded"] = _segments(context.report.segments, context.files)
    view["files"] = [
        {
            "name": one.name,
            "sha256": one.sha256,
            "size": "" if one.size is None else str(one.size),
            "segment": one.segment,
            "anchor": places.get(one.segment, ""),
        }
        for one in context.files
    ]
    view["events"] = [list(event) for event in context.events]
    return render("review.html", view)


def _segments(segments: Sequence[SegmentSummary], files: Sequence[DigestedFile]) -> list[JsonObject]:
    """Returns one entry for each segment: its anchor in the page, its means, and the anchors of its files."""
    found: list[JsonObject] = []
    for number, item in enumerate(segments, 1):
        statistics = item.statistics
        channels = (
            []
            if statistics is None
            else [
                {"name": name, "mean": f"{float(statistics.mean[k]):.8g}", "unit": item.units.get(name, "")}
                for k, name in enumerate(statistics.channels)
            ]
        )
        found.append(
            {
                "label": item.segment.label,
                "anchor": f"s{number}",
                "samples": "–" if statistics is None else str(int(statistics.count)),
                "left_out": "–" if statistics is None else str(int(statistics.rejected)),
                "duration": "–" if statistics is None else words.duration(statistics.end - statistics.start),
                "channels": channels,
                "files": [f"f{place}" for place, one in enumerate(files, 1) if one.segment == item.segment.label],
                "remark": item.remark,
            }
        )
    return found
