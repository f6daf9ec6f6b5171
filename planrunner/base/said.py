"""Makes translatable text for readers: an English template together with the values that are inserted.

`said("{output}: {count} samples are missing.", output="gyro_x", count=3)` is the text "gyro_x: 3 samples are missing.", together
with its template and its values. As in gettext, the template is the message id in the catalogues in `locales/`. `make catalogues`
finds the template in the call. To translate a page, the program looks up the template in a catalogue, and inserts the values in the
format that the template states.

A `Said` is a `str`. If nothing is translated (on the terminal, on a page in English, in a comparison), it is the English text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from string import Formatter

from planrunner.base.documents import Json, JsonObject

Inserted = str | float | tuple[str, ...]
"""A value in a template: a name, another `Said`, a number, or a list of names."""
COUNT = "count"
"""The value that selects the plural form."""
_FORMAT = re.compile(r"\+?(\.\d{1,2})?[dgef%]?")
"""The format specifications that a template may contain. A width is not allowed, because it could fill the memory. Access to the
parts of a value is not allowed either."""


class Said(str):
    """Contains an English text with its template and the inserted values. A text without a template is not translated. `plural`:
    the template that is used if `count` is not 1; empty if there is none."""

    template: str
    values: Mapping[str, Inserted]
    plural: str

    def __new__(
        cls, text: str, template: str = "", values: Mapping[str, Inserted] | None = None, plural: str = ""
    ) -> Said:
        made = super().__new__(cls, text)
        made.template, made.values, made.plural = template, dict(values or {}), plural
        return made

    def __reduce__(self) -> tuple[type[Said], tuple[str, str, Mapping[str, Inserted], str]]:
        return Said, (str(self), self.template, self.values, self.plural)

    @property
    def formats(self) -> dict[str, str]:
        """Maps each name in the template to the format of its value."""
        return formats(self.template) | formats(self.plural)

    @property
    def number(self) -> int:
        """Returns the number that selects the plural form."""
        value = self.values.get(COUNT)
        return value if isinstance(value, int) else 0

    def to_json(self) -> JsonObject:
        """Returns the text as JSON data, with its template and values for translation."""
        if not self.template:
            return {"text": str(self)}
        values = {name: _value_to(value) for name, value in self.values.items()}
        return {
            "text": str(self),
            "template": self.template,
            **({"plural": self.plural} if self.plural else {}),
            **({"values": values} if values else {}),
        }

    @classmethod
    def from_json(cls, data: Json) -> Said:
        """Reads the data of `to_json`. Raises ValueError, KeyError or TypeError for anything else."""
        if not isinstance(data, Mapping):
            raise TypeError(f"{data!r} is not a text with its template")
        if "template" not in data:
            return cls(data["text"])
        values = {str(name): _value_from(value) for name, value in data.get("values", {}).items()}
        return _made(str(data["template"]), str(data.get("plural", "")), values)


def said(template: str, /, **values: Inserted) -> Said:
    """Returns the template with the values inserted. `{name}` inserts a value; `{name:.3g}` inserts a number in this format; `{{`
    is a brace.

    Raises ValueError for a template that uses other features, and KeyError for a name without a value."""
    return _made(template, "", values)


def counted(one: str, many: str, /, count: int, **values: Inserted) -> Said:
    """Does the same as `said`, with the first template if `count` is 1 and the second template otherwise. Each of the two templates
    can contain `{count}`."""
    return _made(one, many, {COUNT: count, **values})


def formats(template: str) -> dict[str, str]:
    """Maps each name in a template to the format of its value. Raises ValueError for a template that uses other features."""
    return {name: form for _, name, form in _pieces(template) if name is not None}


def filled(template: str, shown: Mapping[str, str]) -> str:
    """Returns the template with each name replaced by the given text."""
    return "".join(text + ("" if name is None else shown[name]) for text, name, _ in _pieces(template))


def _made(template: str, plural: str, values: Mapping[str, Inserted]) -> Said:
    chosen = plural if plural and values[COUNT] != 1 else template
    shown = {name: _english(values[name], form) for name, form in formats(chosen).items()}
    return Said(filled(chosen, shown), template, values, plural)


def _english(value: Inserted, form: str) -> str:
    return ", ".join(value) if isinstance(value, tuple) else format(value, form)


@lru_cache(maxsize=1024)
def _pieces(template: str) -> tuple[tuple[str, str | None, str], ...]:
    """Splits a template into tuples of a text, the name of the value that follows the text, and the format of this value. The name
    is None after the last text."""
    found: list[tuple[str, str | None, str]] = []
    for text, name, form, conversion in Formatter().parse(template):
        if name is not None and (not name.isidentifier() or conversion or not _FORMAT.fullmatch(form or "")):
            raise ValueError(f"a text of a report cannot contain {{{name}{':' if form else ''}{form or ''}}}")
        found.append((text, name, form or ""))
    return tuple(found)


def _value_to(value: Inserted) -> Json:
    if isinstance(value, tuple):
        return [_value_to(item) for item in value]
    return value.to_json() if isinstance(value, Said) else value


def _value_from(value: Json) -> Inserted:
    if isinstance(value, list):
        return tuple(Said.from_json(item) if isinstance(item, Mapping) else str(item) for item in value)
    if isinstance(value, Mapping):
        return Said.from_json(value)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise TypeError(f"{value!r} is not a value of a text")
    return value
