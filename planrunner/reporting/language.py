"""Languages of pages: English as templates are written, others through the catalogues of translations in `locales/`.

Catalogues are read as PO text of gettext, so that pages show exactly what reviewers read and nothing has to be compiled. Placeholders have
only the form `%(name)s`, so a template cannot request widths that fill the memory.

Sentences from the data have their placeholders filled already, such as "gyro_x: offset at zero rate". They are looked up directly, then
compared with the messages with placeholders: "%(output)s: offset at zero rate" gives the translation, and the inserted text is kept.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import lru_cache

from planrunner.base.documents import Json
from planrunner.base.shipped import shipped

ENGLISH = "en"
_PLACE = re.compile(r"%(?:%|\((\w+)\)s)")


def languages() -> tuple[str, ...]:
    """The languages with a catalogue, in addition to English."""
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


@lru_cache(maxsize=8)
def sentences(language: str) -> tuple[tuple[re.Pattern[str], str], ...]:
    """Messages with placeholders as patterns of the filled sentence, each with its translation. Messages with more fixed text come
    first, so that the closest match is found."""
    known = [(text, said) for text, said in translations(language).items() if isinstance(said, str) and "%(" in text]
    known.sort(key=lambda pair: (-len(_PLACE.sub("", pair[0])), pair[0]))
    return tuple((_sentence(text), said) for text, said in known)


def _sentence(message: str) -> re.Pattern[str]:
    """Pattern that matches the filled message. A name that occurs twice has the same value in both places."""
    parts, start, seen = [], 0, set()
    for place in _PLACE.finditer(message):
        name = place[1]
        parts.append(re.escape(message[start : place.start()]))
        parts.append("%" if name is None else f"(?P={name})" if name in seen else f"(?P<{name}>.+?)")
        seen.add(name)
        start = place.end()
    return re.compile("".join(parts) + re.escape(message[start:]))


def spoken(language: str) -> dict[str, Callable[..., str]]:
    """The functions that Jinja's i18n extension calls, and `term` for words and sentences that come with the data, such as the
    description of a coefficient. Text without a translation stays as it is. The result is escaped like other text."""
    known = translations(language)

    def gettext(message: str, /, **values: Json) -> str:
        said = known.get(message, message)
        return filled(said if isinstance(said, str) else said[0], values)

    def ngettext(singular: str, plural: str, count: int, /, **values: Json) -> str:
        said = known.get(singular, (singular, plural))
        forms = (said,) if isinstance(said, str) else said
        return filled(forms[0 if count == 1 else -1], {"num": count, **values})

    def term(text: str) -> str:
        said = known.get(text)
        if isinstance(said, str):
            return said
        matches = ((pattern.fullmatch(text), said) for pattern, said in sentences(language))
        return next((filled(said, match.groupdict()) for match, said in matches if match), text)

    return {"_": gettext, "term": term, "gettext": gettext, "ngettext": ngettext}


def filled(message: str, values: Mapping[str, Json]) -> str:
    """The message with `%(name)s` replaced and `%%` as %. Raises KeyError for a name without a value."""
    return _PLACE.sub(lambda place: "%" if place[1] is None else str(values[place[1]]), message)
