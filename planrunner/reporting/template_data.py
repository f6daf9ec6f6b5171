"""Converts the data for templates to JSON and back, so that a user's template can be rendered in a separate process."""

from __future__ import annotations

import json
from collections.abc import Mapping

from planrunner.base.documents import Json, JsonObject
from planrunner.base.said import Said


class Told(dict[str, str]):
    """Run information by name; a missing item is an empty text."""

    def __missing__(self, name: str) -> str:
        return ""


# All JSON objects have this form, so that no name or value in the data can imitate one.
_PAIRS, _TOLD, _HTML, _SAID = "pairs", "told", "html", "said"


def to_json(given: Mapping[str, Json]) -> str:
    """Converts the data to JSON text, after drawing every picture. Raises TypeError for an object that is not plain data."""
    return json.dumps(_plain(given), ensure_ascii=True)


def from_json(text: str) -> JsonObject:
    """Reads the data for a template from JSON text. Pictures become markup that is not escaped."""
    given: JsonObject = json.loads(text, object_hook=_restored)
    return given


def _plain(value: Json) -> Json:
    if hasattr(value, "__html__"):
        return {_HTML: value.__html__()}
    if isinstance(value, Said):
        return {_SAID: json.dumps(value.to_json())}
    if isinstance(value, Mapping):
        pairs = [[_plain(name), _plain(item)] for name, item in value.items()]
        return {_TOLD if isinstance(value, Told) else _PAIRS: pairs}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, str | int | float):
        return value
    raise TypeError(f"{type(value).__name__} is not plain data")


def _restored(found: JsonObject) -> Json:
    from markupsafe import Markup

    ((kind, value),) = found.items()
    if kind == _HTML:
        return Markup(value)
    if kind == _SAID:
        return Said.from_json(json.loads(value))
    return Told(value) if kind == _TOLD else dict(value)
