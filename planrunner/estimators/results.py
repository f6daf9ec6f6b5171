"""Defines the results of an analysis, and writes and reads them as JSON (schemas/results.schema.json). Numbers are written with
full precision, so that reading gives exactly the same floats.

JSON has no infinity and no NaN. These numbers are always written as the texts "inf", "-inf" and "nan".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field, fields

import numpy as np

from planrunner.archive.recording import Find, RecordedSegment
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.said import Said
from planrunner.estimators.interface import Coefficient, CoefficientRole, Estimate
from planrunner.estimators.limits import LimitVerdict
from planrunner.estimators.tables import Plot, Role, Table, TableColumn
from planrunner.instruments.models import DataOrigin
from planrunner.uncertainty.influences import Budget, BudgetLine

NAME = "results.json"
"""Name of the file that contains the results of an analysis."""
FORMAT = 3
"""Format of the results. Descriptions, notes and warnings consist of the text and of a template with values, so that they can be
translated."""
NAMED = 1000
"""Maximum number of detected outliers of a segment that are listed in the results."""
_NUMBERS = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


@dataclass(frozen=True, slots=True)
class Results:
    """The results of an analysis.

    `estimates`: the estimates by name, in the plan's order. `limits`: the verdicts on the limits. `failures`: maps the name of an
    estimate or limit without a result to a message. `segments`: for each recorded segment, the statistics from
    `segment_statistics`. `origin`: source of the samples; None if the bench does not state it. `unfit`:
    names in `failures` whose failure is caused by the recorded data, not by the plan.
    """

    estimates: Mapping[str, Estimate]
    limits: tuple[LimitVerdict, ...] = ()
    failures: Mapping[str, str] = field(default_factory=dict)
    segments: tuple[Mapping[str, Json], ...] = ()
    origin: DataOrigin | None = None
    unfit: tuple[str, ...] = ()

    def to_json(self) -> JsonObject:
        """Converts the results to plain JSON data without NaN or infinities."""
        found: JsonObject = _plain(
            {
                "planrunner_results": FORMAT,
                **({} if self.origin is None else {"origin": self.origin}),
                "estimates": [_estimate_to(estimate) for estimate in self.estimates.values()],
                "limits": [_fields(limit) for limit in self.limits],
                "failures": dict(self.failures),
                **({"unfit": list(self.unfit)} if self.unfit else {}),
                "segments": [dict(segment) for segment in self.segments],
            }
        )
        return found

    @classmethod
    def from_json(cls, data: Mapping[str, Json], file: str = "results.json") -> Results:
        """Reads the results that `to_json` wrote. Raises `InputError` for another format."""
        if not isinstance(data, Mapping) or data.get("planrunner_results") != FORMAT:
            message = "this file contains no results in a format that this version can read"
            raise InputError.at(
                Mark(file), "results-format", message, "open it with the version that wrote it, or estimate again"
            )
        restored = _numbers(data)
        try:
            estimates = [_estimate_from(item) for item in restored["estimates"]]
            limits = tuple(LimitVerdict(**item) for item in restored["limits"])
            return cls(
                {item.name: item for item in estimates},
                limits,
                restored["failures"],
                tuple(restored["segments"]),
                restored.get("origin"),
                tuple(restored.get("unfit", ())),
            )
        except (KeyError, TypeError, ValueError) as error:
            message = f"the results are incomplete or changed ({type(error).__name__}: {error})"
            raise InputError.at(Mark(file), "results-format", message, "estimate again from the run folder") from None


def segment_statistics(recorded: RecordedSegment) -> JsonObject:
    """Returns the statistics of one recorded segment as plain data. Means and other values are given by channel, in the unit of the
    channel."""
    statistics = recorded.statistics
    deviation = np.sqrt(np.diag(np.atleast_2d(statistics.covariance)))
    channels = {
        name: {
            "unit": recorded.units.get(name, ""),
            "mean": float(statistics.mean[k]),
            "standard_deviation": float(deviation[k]),
            "standard_error": float(statistics.standard_error[k]),
            "minimum": float(statistics.minimum[k]),
            "maximum": float(statistics.maximum[k]),
        }
        for k, name in enumerate(statistics.channels)
    }
    return {
        "label": recorded.label,
        "count": int(statistics.count),
        "rejected": int(statistics.rejected),
        "batches": int(statistics.batches),
        "start": float(statistics.start),
        "end": float(statistics.end),
        "largest_gap": float(statistics.largest_gap),
        "truncated": bool(recorded.truncated),
        "readings": {name: float(value) for name, value in recorded.readings.items()},
        "channels": channels,
        **({"finds": [_find_to(one) for one in recorded.finds[:NAMED]]} if recorded.finds else {}),
    }


def comparable(data: Json) -> Json:
    """Converts results to a form in which they can be compared. The versions that computed the results, and data that serve only
    for translations are omitted."""
    if isinstance(data, list):
        return [comparable(item) for item in data]
    if not isinstance(data, dict):
        return data
    if _is_said(data):
        return data["text"]
    return {name: comparable(item) for name, item in data.items() if name != "computed_with"}


def _is_said(data: Json) -> bool:
    return isinstance(data, dict) and "text" in data and data.keys() <= {"text", "template", "plural", "values"}


def differences(stored: Json, now: Json, place: str = "") -> Iterator[tuple[str, bool]]:
    """Yields each place at which two results differ, such as `estimates.bias.notes.1`, and True if only a text differs there.
    `place`: the place that contains both. The versions that computed the results are left out."""
    if isinstance(stored, dict) and isinstance(now, dict) and not (_is_said(stored) or _is_said(now)):
        for name in {**stored, **now}:
            if name != "computed_with":
                yield from differences(stored.get(name), now.get(name), f"{place}.{name}".lstrip("."))
    elif isinstance(stored, list) and isinstance(now, list) and len(stored) == len(now):
        for number, (one, other) in enumerate(zip(stored, now, strict=True), start=1):
            name = one.get("name", number) if isinstance(one, dict) else number
            yield from differences(one, other, f"{place}.{name}")
    elif repr(comparable(stored)) != repr(comparable(now)):
        both = [one for side in (stored, now) for one in (side if isinstance(side, list) else [side])]
        yield place, all(map(_is_said, both))


def _find_to(one: Find) -> JsonObject:
    return {
        "kind": one.kind.value,
        "channel": one.channel,
        "first": one.first,
        "rows": one.rows,
        "time": one.time,
        "seconds": one.seconds,
        "size": one.size,
        "noise": one.noise,
        "count": one.count,
        "bad": one.bad,
    }


def _estimate_to(estimate: Estimate) -> JsonObject:
    return {
        "name": estimate.name,
        "estimator": estimate.estimator,
        "coefficients": [_fields(one) | {"description": _said_to(one.description)} for one in estimate.coefficients],
        "covariance": np.asarray(estimate.covariance, dtype=float).tolist(),
        "headline": list(estimate.headline),
        "settings": dict(estimate.settings),
        "tables": [_table_to(table) for table in estimate.tables],
        "plots": [_fields(plot) for plot in estimate.plots],
        "notes": [_said_to(text) for text in estimate.notes],
        "warnings": [_said_to(text) for text in estimate.warnings],
        "segments": list(estimate.segments),
        "extra": dict(estimate.extra),
        "budgets": [
            _fields(budget) | {"lines": [_fields(line) for line in budget.lines]} for budget in estimate.budgets
        ],
    }


def _said_to(text: str) -> JsonObject:
    """Writes a text as JSON data. A plug-in may give plain text, which is not translated."""
    return (text if isinstance(text, Said) else Said(text)).to_json()


def _fields(record: LimitVerdict | Coefficient | Plot | Budget | BudgetLine | Table | TableColumn) -> JsonObject:
    return {item.name: getattr(record, item.name) for item in fields(record)}


def _table_to(table: Table) -> JsonObject:
    return _fields(table) | {"columns": [_fields(one) for one in table.columns]}


def _table_from(data: Mapping[str, Json]) -> Table:
    columns = tuple(TableColumn(one["title"], Role(one["role"]), one["unit"]) for one in data["columns"])
    return Table(data["title"], columns, tuple(map(tuple, data["rows"])), data["terminal"])


def _estimate_from(data: Mapping[str, Json]) -> Estimate:
    rest: JsonObject = {key: tuple(data[key]) for key in ("headline", "segments")}
    rest |= {key: tuple(map(Said.from_json, data[key])) for key in ("notes", "warnings")}
    tables = tuple(map(_table_from, data["tables"]))
    plots = tuple(
        Plot(
            item["title"],
            item["x_title"],
            item["y_title"],
            tuple(item["x"]),
            {name: tuple(values) for name, values in item["series"].items()},
            {name: tuple(values) for name, values in item["uncertainties"].items()},
            bool(item.get("log", False)),
            bool(item.get("lines", False)),
        )
        for item in data["plots"]
    )
    return Estimate(
        name=data["name"],
        estimator=data["estimator"],
        coefficients=tuple(
            Coefficient(
                **{
                    **item,
                    "description": Said.from_json(item["description"]),
                    "role": CoefficientRole(item["role"]),
                }
            )
            for item in data["coefficients"]
        ),
        covariance=np.array(data["covariance"], dtype=float),
        settings=data["settings"],
        tables=tables,
        plots=plots,
        extra=data["extra"],
        budgets=tuple(
            Budget(**{**item, "lines": tuple(BudgetLine(**line) for line in item["lines"])}) for item in data["budgets"]
        ),
        **rest,
    )


def _plain(value: Json) -> Json:
    """Converts a value to plain JSON data: numpy scalars and arrays, tuples and mappings become plain values, and numbers that JSON
    cannot represent become texts."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)


def _numbers(value: Json) -> Json:
    if isinstance(value, dict):
        return {name: _numbers(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    return _NUMBERS.get(value, value) if isinstance(value, str) else value
