"""Renders templates in a Jinja environment in which a template can only arrange its data.

The environment is sandboxed. Text is escaped if it does not come from this program. An undefined name is an error. Templates are
read from the user's folder, if one is named, and then from the shipped folder. Every failure is a `ReportError` that names the
template, the line and the reason.
"""

from __future__ import annotations

import base64
import functools
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planrunner.base.documents import Json
from planrunner.base.regular_files import RefusedFileError, read_regular
from planrunner.base.shipped import shipped
from planrunner.reporting.language import ENGLISH, languages, spoken

if TYPE_CHECKING:
    from jinja2 import Environment

ENDING = ".j2"
MAX_OUTPUT = 50_000_000  # characters
MAX_TEMPLATE = 1_000_000  # bytes
MAX_OPERAND = 1_000_000
TRANSLATED = ("certificate.html",)  # templates whose texts are in the catalogues
_TEXT_METHODS = frozenset(
    ("upper", "lower", "title", "capitalize", "strip", "lstrip", "rstrip", "split", "startswith", "endswith", "join")
)
_MAPPING_METHODS = frozenset(("items", "keys", "values", "get"))
_REMOVED_FILTERS = ("center", "format", "indent", "pprint", "random", "wordwrap", "xmlattr")


class ReportError(Exception):
    """Reports that a report cannot be written. The message gives the template, the line and the reason, for the author of the
    template."""


def available(folder: Path | None = None) -> tuple[str, ...]:
    """Returns the names of the available reports. The name of a report is the name of a template in one of the folders, without the
    extension `.j2`. For a translated report, it is `name.LANGUAGE.html`."""
    found = {path.name.removesuffix(ENDING) for root in _roots(folder) for path in root.glob("*" + ENDING)}
    for name in TRANSLATED:
        stem, _, ending = name.partition(".")
        found |= {f"{stem}.{language}.{ending}" for language in languages()}
    return tuple(sorted(found))


def _template_of(name: str, roots: tuple[Path, ...]) -> tuple[str, str]:
    """Returns the template file and the language of a report. For example, `certificate.zh.html` is `certificate.html` in Chinese,
    unless a template with the name `certificate.zh.html` exists."""
    full = name if name.endswith(ENDING) else name + ENDING
    parts = full.split(".")
    if len(parts) == 4 and parts[1] in languages() and not any((root / full).is_file() for root in roots):
        return ".".join((parts[0], *parts[2:])), parts[1]
    return full, ENGLISH


def lay_out(name: str, given: Mapping[str, Json], folder: Path | None = None, most: int = MAX_OUTPUT) -> str:
    """Renders a template in this process and returns the text.

    `name`: name of the template, with or without `.j2`. `given`: the data. `folder`: a user's template folder, which is searched
    before the shipped one. `most`: maximum number of characters of the text. Raises `ReportError` if the template cannot be rendered.
    """
    import jinja2

    roots = _roots(folder)
    full, language = _template_of(name, roots)
    environment = _environment(roots, not full.endswith((".md" + ENDING, ".txt" + ENDING)), language)
    pieces: list[str] = []
    size = 0
    try:
        for piece in environment.get_template(full).generate(**given):
            size += len(piece)
            if size > most:
                raise ReportError(f"{full}: the report grows beyond {most / 1e6:g} million characters")
            pieces.append(piece)
    except jinja2.TemplateNotFound as error:
        if error.name == full != name and folder is not None and name == Path(name).name and (folder / name).is_file():
            raise ReportError(f"'{name}' is not named as a template: rename it to '{full}'") from None
        known = ", ".join(available(folder))
        raise ReportError(f"there is no template '{error.name}'; the known templates are {known}") from None
    except jinja2.TemplateSyntaxError as error:
        raise ReportError(f"{error.name or full}:{error.lineno}: {error.message}") from None
    except ReportError:
        raise
    except Exception as error:  # an expression in a template may raise anything
        raise ReportError(f"{_place(error, full)}: {_reason(error)}") from None
    return "".join(pieces)


def _reason(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return "the template needs more memory than a report may use"
    text = " ".join(str(error).split())[:300]
    kind = "" if type(error).__module__.startswith("jinja2") else f"{type(error).__name__}: "
    return f"{kind}{text}" or type(error).__name__


def _place(error: Exception, name: str) -> str:
    """Returns the position, as `template:line`, of the innermost template line that caused the error."""
    place, trace = name, error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if file.endswith(ENDING):
            place = f"{Path(file).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _roots(folder: Path | None) -> tuple[Path, ...]:
    own = shipped("templates").resolve()
    if folder is None:
        return (own,)
    if not folder.is_dir():
        raise ReportError(f"{folder} is not a folder of templates")
    return (folder.resolve(), own)


@functools.lru_cache(maxsize=8)
def _environment(roots: tuple[Path, ...], escaping: bool, language: str) -> Environment:
    import jinja2
    from jinja2.exceptions import SecurityError
    from jinja2.sandbox import ImmutableSandboxedEnvironment
    from markupsafe import Markup

    class Closed(ImmutableSandboxedEnvironment):
        """The sandboxed environment. A template can call only permitted methods, and cannot fill the memory by arithmetic."""

        intercepted_binops = frozenset(("*", "**", "%"))

        def is_safe_attribute(self, obj: Any, attr: str, value: Any) -> bool:
            if isinstance(obj, str) and callable(value):
                return attr in _TEXT_METHODS
            if isinstance(obj, Mapping) and callable(value):
                return attr in _MAPPING_METHODS
            return super().is_safe_attribute(obj, attr, value)

        def wrap_str_format(self, value: Any) -> None:
            """Returns None, so that `is_safe_attribute` refuses `str.format` and `str.format_map`. A format with a large
            width would fill the memory."""

        def call_binop(self, context: Any, operator: str, left: Any, right: Any) -> Any:
            for operand in (left, right):
                number = isinstance(operand, int | float) and abs(operand) <= MAX_OPERAND
                if not number or operator == "**":
                    raise SecurityError(
                        f"'{operator}' is allowed only for numbers up to {MAX_OPERAND}, and powers are not allowed"
                    )
            return super().call_binop(context, operator, left, right)

    def escaped(value: Any) -> Any:
        return value if isinstance(value, Markup) else markdown(str(value))

    class Folders(jinja2.BaseLoader):
        def get_source(self, environment: Any, template: str) -> tuple[str, str, Callable[[], bool]]:
            for root in roots:
                path = (root / template).resolve()
                if (root / template).is_symlink() and not path.is_relative_to(root):
                    raise ReportError(f"{root / template}: a link that leads out of the folder; copy the file itself")
                if path.is_relative_to(root) and path.exists():
                    try:
                        # Shipped templates do not change while the program runs and are compiled once.
                        kept = root == roots[-1]
                        return read_regular(path, MAX_TEMPLATE).decode("utf-8"), str(path), lambda kept=kept: kept
                    except RefusedFileError as refused:
                        raise ReportError(f"{path}: {refused}; {refused.hint}") from None
                    except UnicodeDecodeError:
                        raise ReportError(f"{path}: the template is not UTF-8 text") from None
            raise jinja2.TemplateNotFound(template)

    environment = Closed(
        loader=Folders(),
        autoescape=escaping,
        undefined=jinja2.StrictUndefined,
        finalize=None if escaping else escaped,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        extensions=("jinja2.ext.i18n",),
    )
    for removed in _REMOVED_FILTERS:
        environment.filters.pop(removed)
    environment.globals = {"range": environment.globals["range"], "namespace": environment.globals["namespace"]}
    environment.globals |= {"language": language, "digest": digest, **spoken(language)}
    # Placeholders are filled by functions of this module, not by formatting in the template.
    environment.newstyle_gettext = True  # type: ignore[attr-defined]
    environment.policies["ext.i18n.trimmed"] = True
    return environment


def digest(text: str) -> str:
    """Returns the SHA-256 of a style, for the content security policy of a page."""
    import hashlib

    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


_SPECIAL = re.compile(r"^[#+-](?=\s)|[\\`*\[\]|~]|(?<!\w)_|_(?!\w)")


def markdown(text: str) -> str:
    """Returns a text on one line, escaped so that Markdown shows it unchanged."""
    one_line = " ".join(text.split())
    return _SPECIAL.sub(r"\\\g<0>", one_line).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
