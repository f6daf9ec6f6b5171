"""The versioned formats of a run folder's JSON files, and how a file is held against its schema in `schemas/`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from planrunner.archive.integrity import IntegrityError

RUN_FORMAT = 1
SEAL_FORMAT = 1
DIGESTS_FORMAT = 1

_TYPES: dict[str, tuple[type, ...]] = {
    "integer": (int,),
    "number": (int, float),
    "string": (str,),
    "boolean": (bool,),
    "object": (dict,),
    "array": (list,),
    "null": (type(None),),
}


def to_bytes(value: Any) -> bytes:
    """JSON text of a file: full precision, no NaN, the same bytes for the same data. A lone surrogate becomes its escape."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode("utf-8", "backslashreplace")


@lru_cache(maxsize=8)
def schema(name: str) -> dict[str, Any]:
    """A shipped JSON Schema: `run`, `journal-event`, `seal`, `digests` or `issued`."""
    from planrunner.shipped import shipped

    data: dict[str, Any] = json.loads((shipped("schemas") / f"{name}.schema.json").read_text(encoding="utf-8"))
    return data


def read_json(path: Path, name: str, version_key: str, newest: int) -> dict[str, Any]:
    """A JSON file of a run folder, held against its schema. Raises `IntegrityError`."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise IntegrityError(f"{path}: cannot be read: {error.strerror}; is this a run folder?") from None
    except (ValueError, RecursionError) as error:
        raise IntegrityError(f"{path}: not JSON: {str(error)[:200]}; take the file from a backup") from None
    version = data.get(version_key) if isinstance(data, dict) else None
    if isinstance(version, int) and version > newest:
        raise IntegrityError(f"{path}: format {version}; this planrunner reads up to {newest}: use a newer planrunner")
    from jsonschema import Draft202012Validator

    for fault in sorted(
        Draft202012Validator(schema(name)).iter_errors(data), key=lambda fault: list(map(str, fault.path))
    ):
        place = "/".join(map(str, fault.path)) or "the top"
        raise IntegrityError(f"{path}: at {place}: {fault.message[:300]}; take the file from a backup")
    checked: dict[str, Any] = data
    return checked


def event_fault(event: Mapping[str, Any]) -> str | None:
    """What is wrong with a journal event, quickly: its kind, required keys and their types as the schema gives them.

    A long journal has hundreds of thousands of events; the whole schema is for `check_event`.
    """
    required = _required()
    kind = event.get("event")
    if kind not in required:
        return f"is of an unknown kind {kind!r}"
    for key, types in required[kind].items():
        value = event.get(key, _TYPES)
        if value is _TYPES:
            return f"lacks '{key}'"
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            return f"has a {type(value).__name__} as '{key}'"
    return None


def check_event(event: Mapping[str, Any]) -> str | None:
    """What is wrong with a journal event by its whole schema."""
    from jsonschema import Draft202012Validator

    for error in Draft202012Validator(schema("journal-event")).iter_errors(event):
        return str(error.message)[:300]
    return None


@lru_cache(maxsize=1)
def _required() -> dict[str, dict[str, tuple[type, ...]]]:
    """Event kind → required key → Python types."""
    table = {}
    whole = schema("journal-event")
    common = whole["properties"]
    for kind, branch in whole["$defs"]["events"].items():
        properties = {**branch["properties"], **common}
        keys = [*whole["required"], *branch["required"]]
        table[kind] = {key: _python_types(properties[key], whole) for key in keys}
    return table


def _python_types(entry: Mapping[str, Any], whole: Mapping[str, Any]) -> tuple[type, ...]:
    while "$ref" in entry:
        target: Any = whole
        for step in entry["$ref"].removeprefix("#/").split("/"):
            target = target[step]
        entry = target
    if "const" in entry:
        return (type(entry["const"]),)
    kinds = entry["type"] if isinstance(entry["type"], list) else [entry["type"]]
    return tuple(kind for name in kinds for kind in _TYPES[name])
