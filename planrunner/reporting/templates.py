"""Makes pages from templates. Shipped templates are rendered in this process; templates of users are rendered in a child process
with limits on time and memory. For the child process, the data are converted to JSON and back.

Templates of both kinds are rendered in the sandbox. Shipped templates are part of the program and are tested with it. Even within
the sandbox, a user's template may loop for ever or fill the memory, and this must not make a long run fail. Therefore, a child
process renders the user's template: the process receives the data as JSON, and returns the page or the error. Any failure of the
child process is a `ReportError`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from planrunner.base.documents import Json, JsonObject
from planrunner.base.said import Said
from planrunner.reporting.sandbox import MAX_OUTPUT, ReportError, lay_out

MAX_SECONDS = 30.0
"""Maximum computing time of a user's template, s."""
MAX_MEMORY = 1 << 30
"""Maximum memory for a user's template in bytes, including the program that renders it."""
PATIENCE = 10
"""Multiple of `MAX_SECONDS` after which the parent process ends the child process. The multiple allows for a busy computer."""


def render(name: str, given: Mapping[str, Json], folder: Path | None = None) -> str:
    """Renders the template `name` (with or without `.j2`) with the data `given`, which must be plain data; returns the text.

    The name may contain a language, as in `certificate.zh.html`. `folder`: a user's template folder, which is searched before the
    shipped one. Raises `ReportError` if the template cannot be rendered.
    """
    return lay_out(name, given) if folder is None else _lay_out_apart(name, given, folder)


def _lay_out_apart(name: str, given: Mapping[str, Json], folder: Path) -> str:
    request = {
        "name": name,
        "folder": str(folder.resolve()),
        "given": to_json(given),
        "most": MAX_OUTPUT,
        "seconds": MAX_SECONDS,
        "memory": MAX_MEMORY,
    }
    import subprocess

    command = [sys.executable, "-m", "planrunner.reporting.template_process"]
    try:
        done = subprocess.run(
            command, input=json.dumps(request).encode(), capture_output=True, timeout=PATIENCE * MAX_SECONDS
        )
    except subprocess.TimeoutExpired:
        raise ReportError(f"{name}: the template takes longer than {PATIENCE * MAX_SECONDS:g} s; {_LOOK}") from None
    except OSError as error:
        raise ReportError(f"{name}: no process can be started for it: {error.strerror or error}") from None
    try:
        answer = json.loads(done.stdout)
    except ValueError:  # ended by the system, most likely because of memory or time
        limits = f"{MAX_SECONDS:g} s of computing or {MAX_MEMORY / 1e9:.1f} GB of memory"
        raise ReportError(f"{name}: the template takes more than {limits}; {_LOOK}") from None
    if "page" not in answer:
        raise ReportError(answer["error"])
    page: str = answer["page"]
    return page


_LOOK = "check its loops"


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
