"""Defines the versioned formats of a run folder's JSON files, and validates the files against `schemas/`. Also defines the error
for a folder that differs from what was written (exit code 4)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NoReturn

from planrunner.archive.schema_check import Check, compile_schema
from planrunner.base.documents import Json, JsonObject


class IntegrityError(Exception):
    """Reports that a file of a run folder is missing, was changed, or does not match its schema. The message names the file and the
    remedy. `code`: the code of the finding that reports this error."""

    def __init__(self, message: str, code: str = "run-changed"):
        super().__init__(message)
        self.code = code


class FormatError(IntegrityError):
    """Reports that a file of a run folder has a format that this version of planrunner does not read. `version`: format of the file.
    `known`: the format that is read."""

    def __init__(self, path: Path, version: int, known: int):
        super().__init__(
            f"{path}: its format is {version}, but this version of planrunner reads only format {known}: use the version of "
            f"planrunner that wrote it"
        )
        self.path, self.version, self.known = path, version, known

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.path, self.version, self.known)


RUN_FORMAT = 1
SEAL_FORMAT = 2
DIGESTS_FORMAT = 3
HEAD_FORMAT = 1
MOST_LEVELS = 64
"""Maximum nesting depth of a JSON file or line."""
FROM_BACKUP = "restore the run folder from a backup"


def to_bytes(value: Json) -> bytes:
    """Returns the JSON text for a file, with full precision and without NaN. The same data always give the same bytes. A lone
    surrogate is written as its escape sequence."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode("utf-8", "backslashreplace")


def digested(value: JsonObject) -> bytes:
    """Returns the JSON text of a file that contains its own digest. The last key, `digest`, contains the SHA-256 of the text
    without this key."""
    return to_bytes({**value, "digest": hashlib.sha256(to_bytes(value)).hexdigest()})


def require_own_digest(data: bytes, value: JsonObject, path: Path) -> None:
    """Checks the digest in a file whose text was made by `digested`. A tree head that was printed has no key `digest`, and passes
    the check. Raises `IntegrityError` if the digest is wrong."""
    if "digest" in value and digested({key: item for key, item in value.items() if key != "digest"}) != data:
        raise IntegrityError(f"{path}: changed after it was written: it does not match its own digest; {FROM_BACKUP}")


def from_bytes(data: bytes) -> Json:
    """Reads JSON data. Raises ValueError for text that is not JSON, and for NaN, infinities and excessive nesting."""
    try:
        value = _decode(data.decode("utf-8"))
    except RecursionError:
        raise ValueError(f"more than {MOST_LEVELS} nested brackets") from None
    if data.count(b"{") + data.count(b"[") > MOST_LEVELS and _too_deep(value):
        raise ValueError(f"more than {MOST_LEVELS} nested brackets")
    return value


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


_decode = json.JSONDecoder(parse_constant=_refuse).decode


def _too_deep(value: Json) -> bool:
    level = [value]
    for _ in range(MOST_LEVELS + 1):
        if not level:
            return False
        level = [
            inner
            for item in level
            if isinstance(item, dict | list)
            for inner in (item.values() if isinstance(item, dict) else item)
        ]
    return True


@lru_cache(maxsize=8)
def schema(name: str) -> JsonObject:
    """Returns a shipped JSON Schema: `run`, `journal-event`, `seal`, `digests`, `issued` or `results`."""
    from planrunner.base.shipped import shipped

    data: JsonObject = json.loads((shipped("schemas") / f"{name}.schema.json").read_text(encoding="utf-8"))
    return data


@lru_cache(maxsize=8)
def _check_of(name: str) -> Check:
    whole = schema(name)
    return compile_schema(whole, whole)


def parse_json(data: bytes, path: Path, name: str, version_key: str, known: int) -> JsonObject:
    """Returns the content of a JSON file of a run folder, checked against its schema. `path`: path of the file, for messages.
    Raises `IntegrityError` if the content does not match the schema."""
    try:
        value = from_bytes(data)
    except ValueError as error:
        raise IntegrityError(f"{path}: not JSON: {str(error)[:200]}; {FROM_BACKUP}") from None
    version = value.get(version_key) if isinstance(value, dict) else None
    if type(version) is int and version != known:
        raise FormatError(path, version, known)
    fault = _check_of(name)(value)
    if fault is not None:
        place, _, what = fault.partition(": ")
        raise IntegrityError(f"{path}: at {place.strip('/') or 'the top'}: {what}; {FROM_BACKUP}")
    checked: JsonObject = value
    return checked


def event_fault(event: Mapping[str, Json]) -> str | None:
    """Returns the reason why the schema rejects a journal event; None if the event is valid."""
    kind = event.get("event")
    check = _events().get(kind) if isinstance(kind, str) else None
    if check is None:
        return f"is of an unknown kind {str(kind)[:40]!r}"
    fault = check(event)
    if fault is None:
        return None
    place, _, what = fault.partition(": ")
    return f"does not match its schema: {place.strip('/')}{': ' if place else ''}{what}"


@lru_cache(maxsize=1)
def _events() -> dict[str, Check]:
    """Maps each kind of event to the function that checks events of this kind. The function checks the keys that all events have,
    and the keys that only this kind has."""
    whole = schema("journal-event")
    checks = {}
    for kind, branch in whole["$defs"]["events"].items():
        properties = {**branch["properties"], **{name: whole["properties"][name] for name in ("seq", "at", "previous")}}
        required = [*whole["required"], *branch["required"]]
        checks[kind] = compile_schema({**branch, "properties": properties, "required": required}, whole)
    return checks
