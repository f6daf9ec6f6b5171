"""Writes JSON Schemas (draft 2020-12) of plans, benches and suites. The schemas are generated from the records with which the
program reads these files.

The command `python -m planrunner.tasks.write_schemas schemas` writes the schemas; a test checks that the files are up to date.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from planrunner.base.documents import Json, JsonObject
from planrunner.plan import quantity
from planrunner.plan.kinds import Schema, keys_of, object_schema
from planrunner.plan.units import DIMENSIONS

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def plan_schema() -> Schema:
    """Returns the schema of plan files, with the parameters of every installed estimator."""
    from planrunner.plan.model import Plan
    from planrunner.plan.segments import SegmentSpec

    segment = {
        "description": "A state to reach and hold, a sweep, or steps that share a state.",
        **object_schema(keys_of(SegmentSpec)),
    }
    return _document("planrunner plan", object_schema(keys_of(Plan)), {"segment": segment})


def bench_schema() -> Schema:
    """Returns the schema of bench files, with the parameters of every installed instrument driver."""
    from planrunner.bench.model import Bench

    return _document("planrunner bench", object_schema(keys_of(Bench)), {})


def suite_schema() -> Schema:
    """Returns the schema of suite files."""
    from planrunner.night.suite import Suite

    return _document("planrunner suite", object_schema(keys_of(Suite)), {})


def _document(title: str, schema: Schema, definitions: dict[str, Schema]) -> Schema:
    """Returns the complete schema of a kind of file. Parts that many keys use, such as a quantity of time, are defined once in
    `$defs`."""
    shared = _shared()
    names = {json.dumps(part, sort_keys=True): name for name, part in shared.items()}
    used: set[str] = set()
    body = _with_references(schema, names, used)
    definitions = {name: _with_references(part, names, used) for name, part in definitions.items()}
    queue = list(used)
    while queue:
        name = queue.pop()
        if name not in definitions:
            inner: set[str] = set()
            part = {key: _with_references(value, names, inner) for key, value in shared[name].items()}
            definitions[name] = part
            queue.extend(inner)
    return {"$schema": DRAFT, "title": title, **body, "$defs": dict(sorted(definitions.items()))}


def _shared() -> dict[str, Schema]:
    from planrunner.plan.orientation import OrientationKind
    from planrunner.plan.segments import MotionSpec

    parts: dict[str, Schema] = {"orientation": OrientationKind().schema(), "motion": object_schema(keys_of(MotionSpec))}
    for dimension in (None, *DIMENSIONS):
        name = (dimension or "any").replace(" ", "-")
        parts[f"uncertain-{name}"] = quantity.schema(dimension, uncertain=True)
        # The text of a quantity is the same for every unit.
        plain = "-or-number" if dimension in (None, "ratio") else ""
        parts[f"uncertain-text{plain}"] = quantity.text_schema(dimension, uncertain=True)
        parts[f"quantity{plain}"] = quantity.schema(dimension, uncertain=False)
    return parts


def _with_references(schema: Json, names: dict[str, str], used: set[str]) -> Json:
    """Returns a copy of `schema`, in which all parts that have a name in `names` are replaced by references. Descriptions and
    examples stay next to the references."""
    if isinstance(schema, list):
        return [_with_references(item, names, used) for item in schema]
    if not isinstance(schema, dict):
        return schema
    about = {key: value for key, value in schema.items() if key in ("description", "examples")}
    rest = {key: value for key, value in schema.items() if key not in about}
    name = names.get(json.dumps(rest, sort_keys=True))
    if name is not None:
        used.add(name)
        return {**about, "$ref": f"#/$defs/{name}"}
    return {**about, **{key: _with_references(value, names, used) for key, value in rest.items()}}


def text(schema: JsonObject) -> str:
    """Returns a schema as the text of a file."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


SCHEMAS = {"plan.schema.json": plan_schema, "bench.schema.json": bench_schema, "suite.schema.json": suite_schema}


def main(folder: str) -> None:
    for name, make in SCHEMAS.items():
        (Path(folder) / name).write_text(text(make()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
