"""Provides the languages of pages: English from the templates, and other languages from the catalogues of translations in
`locales/`.

Catalogues are read as gettext PO text. Pages therefore show exactly the texts that reviewers read, and nothing has to be compiled.
A placeholder of a page template can only have the form `%(name)s`, so that no template can request a width that would fill the
memory.

Texts of estimators are objects `planrunner.base.said.Said`. The template of such a text, for example "{output}: offset at zero
rate", is a message of the catalogue. The translation contains the same names in braces. A number is formatted as in the English
template, with the decimal sign of the language.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import lru_cache

from planrunner.base.documents import Json
from planrunner.base.said import Inserted, Said
from planrunner.base.said import filled as inserted
from planrunner.base.shipped import shipped

ENGLISH = "en"
_PLACE = re.compile(r"%(?:%|\((\w+)\)s)")


def languages() -> tuple[str, ...]:
    """Returns the languages that have a catalogue of translations, in addition to English."""
    return tuple(sorted(path.stem for path in shipped("locales").glob("*.po")))


@lru_cache(maxsize=8)
def translations(language: str) -> Mapping[str, str | tuple[str, ...]]:
    """Maps each English message to its translation, or to the plural forms of its translation. Doubtful (fuzzy) and empty entries
    are omitted. The key of a text with a plural form is its English singular form."""
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
    """Returns the functions that Jinja's i18n extension calls. Also returns the function `term`, which translates texts whose
    templates are in the data, such as the description of a coefficient. Text without a template or without a translation stays as
    it is. The result is escaped like other text."""
    known = translations(language)

    def gettext(message: str, /, **values: Json) -> str:
        said = known.get(message, message)
        return filled(said if isinstance(said, str) else said[0], values)

    def ngettext(singular: str, plural: str, count: int, /, **values: Json) -> str:
        return filled(chosen(singular, plural, count), {"num": count, **values})

    def chosen(singular: str, plural: str, count: int) -> str:
        said = known.get(singular)
        if said is None:
            return singular if count == 1 else plural
        return said if isinstance(said, str) else said[plural_form(language)(count)]

    def shown(value: Inserted, form: str) -> str:
        if isinstance(value, tuple):
            return ", ".join(shown(item, "") for item in value)
        if isinstance(value, Said):
            return term(value)
        return value if isinstance(value, str) else numeral(format(value, form), language)

    def term(text: str) -> str:
        if not isinstance(text, Said) or not text.template:
            return text
        values = {name: shown(text.values[name], form) for name, form in text.formats.items()}
        if text.plural:
            return inserted(chosen(text.template, text.plural, text.number), values)
        said = known.get(text.template, text.template)
        return inserted(said if isinstance(said, str) else said[0], values)

    return {"_": gettext, "term": term, "gettext": gettext, "ngettext": ngettext}


@lru_cache(maxsize=8)
def plural_form(language: str) -> Callable[[int], int]:
    """Returns a function that maps a number to the index of its plural form in the language."""
    from gettext import c2py

    from babel.messages.plurals import get_plural

    rule: Callable[[int], int] = c2py(get_plural(language).plural_expr)
    return rule


@lru_cache(maxsize=8)
def _decimal_sign(language: str) -> str:
    from babel.numbers import get_decimal_symbol

    return str(get_decimal_symbol(language))


def numeral(text: str, language: str) -> str:
    """Returns a formatted number with the decimal sign of the language."""
    return text if language == ENGLISH else text.replace(".", _decimal_sign(language))


def filled(message: str, values: Mapping[str, Json]) -> str:
    """Returns a message after each `%(name)s` has been replaced by its value, and `%%` by `%`. Raises KeyError for a name without a
    value."""
    return _PLACE.sub(lambda place: "%" if place[1] is None else str(values[place[1]]), message)
