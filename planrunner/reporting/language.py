"""Languages of pages: English as templates are written, others through the catalogues of translations in `locales/`.

A catalogue is read as it stands in the tree (gettext's PO text), so that what reviewers read is what pages show and nothing has to be
compiled. Placeholders are `%(name)s` and nothing more: a template cannot ask for widths that fill the memory.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from planrunner.shipped import shipped

ENGLISH = "en"
_PLACE = re.compile(r"%(?:%|\((\w+)\)s)")


def languages() -> tuple[str, ...]:
    """The languages, beside English, that there is a catalogue for."""
    return tuple(sorted(path.stem for path in shipped("locales").glob("*.po")))


@lru_cache(maxsize=8)
def translations(language: str) -> Mapping[str, str | tuple[str, ...]]:
    """English message → translation, or the plural forms of one. Doubtful (fuzzy) and empty entries are left out."""
    if language == ENGLISH:
        return {}
    from babel.messages.pofile import read_po

    with (shipped("locales") / f"{language}.po").open("rb") as file:
        catalogue = read_po(file, locale=language)
    found: dict[str, str | tuple[str, ...]] = {}
    for message in catalogue:
        if message.id and not message.fuzzy:
            said = message.string
            if isinstance(said, list | tuple):
                said = tuple(said) if all(said) else None
            if said:
                found[message.id[0] if isinstance(message.id, list | tuple) else message.id] = said
    return found


def spoken(language: str) -> dict[str, Callable[..., str]]:
    """The functions that Jinja's i18n extension calls, and `term` for words that come with the data, such as the description of a
    coefficient. What a catalogue lacks stays as it is; the result is escaped like other text."""
    known = translations(language)

    def gettext(message: str, /, **values: Any) -> str:
        said = known.get(message, message)
        return filled(said if isinstance(said, str) else said[0], values)

    def ngettext(singular: str, plural: str, count: int, /, **values: Any) -> str:
        said = known.get(singular, (singular, plural))
        forms = (said,) if isinstance(said, str) else said
        return filled(forms[0 if count == 1 else -1], {"num": count, **values})

    def term(text: str) -> str:
        said = known.get(text, text)
        return said if isinstance(said, str) else text

    return {"_": gettext, "term": term, "gettext": gettext, "ngettext": ngettext}


def filled(message: str, values: Mapping[str, Any]) -> str:
    """The message with `%(name)s` replaced and `%%` as %. Raises KeyError for a name without a value."""
    return _PLACE.sub(lambda place: "%" if place[1] is None else str(values[place[1]]), message)
