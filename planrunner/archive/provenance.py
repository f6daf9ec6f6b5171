"""Software that a result depends on: versions of the interpreter, the system and the libraries."""

from __future__ import annotations

import functools
import platform
from importlib import metadata

from planrunner import __version__

LIBRARIES = ("numpy", "scipy", "pyarrow", "pint", "pyyaml", "jsonschema", "jinja2")


def versions() -> dict[str, str]:
    """Name → version; a library that is not installed is left out."""
    found = {
        "planrunner": __version__,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }
    return found | _libraries()


@functools.cache
def _libraries() -> dict[str, str]:
    """Read once, because a process keeps the libraries that it has loaded."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
