"""Makes an estimate from segments in which the screening has found bad samples.

The key `outliers` of the plan decides whether the estimate is made without the bad samples, with them, or not at all.

If the bad samples are left out, the report states how the estimate would change if they were used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from planrunner.archive.recording import Find, FindKind, RecordedSegment
from planrunner.base.said import Inserted, Said, said
from planrunner.estimators.interface import Estimate, EstimationError, UnfitDataError
from planrunner.estimators.tables import Cell, Role, Table, TableColumn, by_columns
from planrunner.observation.screening import rows_of, without_bad

NAMED = 3  # most findings named in a sentence
LISTED = 100  # most findings listed in a table
SMALL = 0.01
"""Smallest change of a coefficient that is listed, in standard uncertainties."""
_SILENT = (FindKind.LOST,)  # there is a separate warning about gaps


def estimated(
    segments: Sequence[RecordedSegment], outliers: str, estimate: Callable[[tuple[RecordedSegment, ...]], Estimate]
) -> tuple[Estimate, tuple[RecordedSegment, ...]]:
    """Computes an estimate with or without the bad samples, as the option `outliers` requires. Returns the estimate, with
    additional warnings and tables about these samples, and the segments that were used.

    Raises the `EstimationError` of the estimator, and `UnfitDataError` if there are bad samples and the plan refuses them.
    """
    found = [(recorded, one) for recorded in segments for one in recorded.finds or ()]
    if not found:
        return estimate(tuple(segments)), tuple(segments)
    bad = [(recorded, one) for recorded, one in found if one.bad]
    if bad and outliers == "refuse":
        raise UnfitDataError(
            f"there are bad samples, and the plan refuses them: {_in_words(bad)}. Record the segments again, leave them out "
            "of `segments`, or write `outliers: exclude`"
        )
    excluded = bool(bad) and outliers == "exclude"
    used = tuple(without_bad(one) if excluded else one for one in segments)
    try:
        made = estimate(used)
    except EstimationError as error:
        if not excluded:
            raise
        raise type(error)(f"{error} (without bad samples: {_in_words(bad)}; `outliers: keep` uses them)") from None
    warnings = list(made.warnings)
    tables = [*made.tables, _table(found, excluded)]
    if excluded:
        text, more = _effect(made, estimate, segments)
        warnings.append(
            said("Bad samples were left out: {finds}. {effect} Examine the recording.", finds=_named(bad), effect=text)
        )
        tables += more
    elif bad:
        warnings.append(
            said(
                "Bad samples were used, as the plan requires: {finds}. With `outliers: exclude`, the report "
                "states their effect.",
                finds=_named(bad),
            )
        )
    rest = [item for item in found if not item[1].bad and item[1].kind not in _SILENT]
    if rest:
        warnings.append(
            said(
                "Screening also found the following, but left out no samples: {finds}. Examine the recording.",
                finds=_named(rest),
            )
        )
    return replace(made, warnings=tuple(warnings), tables=tuple(tables)), used


def _effect(
    made: Estimate,
    estimate: Callable[[tuple[RecordedSegment, ...]], Estimate],
    segments: Sequence[RecordedSegment],
) -> tuple[Said, tuple[Table, ...]]:
    """Returns a sentence and a table about the difference between the estimates with and without the bad samples."""
    try:
        other = {item.name: item for item in estimate(tuple(segments)).coefficients}
    except EstimationError as error:
        return said("With these samples, no estimate can be made ({reason}).", reason=str(error)), ()
    rows: list[tuple[Cell, ...]] = []
    largest, name = 0.0, ""
    for item in made.coefficients:
        if item.name not in other:
            continue
        change = other[item.name].near(item.value) - item.value
        u = item.standard_uncertainty
        ratio = abs(change) / u if u > 0 else (float("inf") if change else 0.0)
        if ratio > largest:
            largest, name = ratio, item.name
        if ratio > SMALL:
            rows.append((item.name, item.value, u, item.value + change, change, ratio, item.unit))
    if not rows:
        return said(
            "These samples change no coefficient by more than {change:g} standard uncertainties.", change=SMALL
        ), ()
    columns = (
        TableColumn("coefficient"),
        TableColumn("without bad samples", Role.VALUE),
        TableColumn("standard uncertainty", Role.STANDARD_UNCERTAINTY),
        TableColumn("with bad samples", Role.VALUE),
        TableColumn("change", Role.VALUE),
        TableColumn("change in standard uncertainties", Role.VALUE),
        TableColumn("unit"),
    )
    text = said(
        "With these samples, {coefficient} would change by {change:.2g} standard uncertainties, more than any "
        "other coefficient.",
        coefficient=name,
        change=largest,
    )
    return text, (Table("Coefficients with and without bad samples", columns, tuple(rows)),)


def _table(found: Sequence[tuple[RecordedSegment, Find]], excluded: bool) -> Table:
    listed = found[:LISTED]
    finds = [one for _, one in listed]
    return by_columns(
        "Screening of the samples",
        (TableColumn("segment"), [recorded.label for recorded, _ in listed]),
        (TableColumn("channel"), [one.channel or "all" for one in finds]),
        (TableColumn("kind"), [one.kind.value for one in finds]),
        (TableColumn("time", Role.NUMBER, "s"), [one.time for one in finds]),
        (TableColumn("duration", Role.NUMBER, "s"), [one.seconds for one in finds]),
        (TableColumn("samples", Role.COUNT), [one.rows for one in finds]),
        (TableColumn("size", Role.VALUE), [one.size for one in finds]),
        (TableColumn("unit"), [recorded.units.get(one.channel, "") for recorded, one in listed]),
        (TableColumn("left out"), ["yes" if one.bad and excluded else "no" for one in finds]),
    )


def _named(found: Sequence[tuple[RecordedSegment, Find]]) -> Inserted:
    """Returns a text that lists the longest findings of the screening, each with kind, segment, channel and time, and states how
    many more there are."""
    ordered = sorted(found, key=lambda item: -item[1].rows)
    texts = tuple(_find(recorded, one) for recorded, one in ordered[:NAMED])
    more = len(ordered) - NAMED
    if more <= 0:
        return texts
    left = sum(
        rows_of([one for other, one in found if other is each]) for each in {id(r): r for r, _ in found}.values()
    )
    return said("{finds} and {more} more; {rows} samples in total", finds=texts, more=more, rows=left)


def _in_words(found: Sequence[tuple[RecordedSegment, Find]]) -> str:
    """Returns the text of `_named` for a message that is not translated."""
    named = _named(found)
    return ", ".join(str(one) for one in named) if isinstance(named, tuple) else str(named)


def _find(recorded: RecordedSegment, one: Find) -> Said:
    one_kind, several = _KINDS[one.kind]
    what = said("{count} {kind}", count=one.count, kind=several) if one.count > 1 else one_kind
    size = f"{one.size:.4g} {recorded.units.get(one.channel, '')}"
    return said(
        "{what} in '{segment}' at {time:.6g} s ({size})",
        what=said("{what} of {channel}", what=what, channel=one.channel) if one.channel else what,
        segment=recorded.label,
        time=one.time,
        size=said("{size}, {rows} samples", size=size, rows=one.rows) if one.rows > 1 else size,
    )


_KINDS = {
    FindKind.SPIKE: (said("spike"), said("spikes")),
    FindKind.BURST: (said("burst"), said("bursts")),
    FindKind.STUCK: (said("stuck stretch"), said("stuck stretches")),
    FindKind.CLIPPED: (said("clipped stretch"), said("clipped stretches")),
    FindKind.REPEATED: (said("repeated stretch"), said("repeated stretches")),
    FindKind.LOST: (said("gap"), said("gaps")),
    FindKind.STEP: (said("step"), said("steps")),
}
"""For each kind of find, its name in the singular and in the plural."""
