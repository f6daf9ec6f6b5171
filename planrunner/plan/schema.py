"""JSON Schemas (draft 2020-12) of plans and benches, generated from the records that also read them.

`python -m planrunner.plan.schema schemas` writes them; a test holds the files equal to what the records say.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from planrunner.plan.kinds import Schema, keys_of, object_schema

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def plan_schema() -> Schema:
    """The schema of plan files, with the parameters of every installed estimator."""
    from planrunner.plan.model import Plan, SegmentSpec

    schema = object_schema(keys_of(Plan))
    segment = {
        "description": "A state to reach and hold, a sweep, or steps that share a state.",
        **object_schema(keys_of(SegmentSpec)),
    }
    return {"$schema": DRAFT, "title": "planrunner plan", **schema, "$defs": {"segment": segment}}


def bench_schema() -> Schema:
    """The schema of bench files, with the parameters of every installed instrument driver."""
    from planrunner.bench.model import Bench

    return {"$schema": DRAFT, "title": "planrunner bench", **object_schema(keys_of(Bench))}


def text(schema: dict[str, Any]) -> str:
    """The file's text."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


SCHEMAS = {"plan.schema.json": plan_schema, "bench.schema.json": bench_schema}


def main(folder: str) -> None:
    for name, make in SCHEMAS.items():
        (Path(folder) / name).write_text(text(make()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
