"""Determines the software on which a result depends: versions of the interpreter, the operating system and the libraries."""

from __future__ import annotations

import functools
import platform
from importlib import metadata

from planrunner import __version__

NUMERICAL = ("numpy", "scipy", "numba")
"""Libraries on which the digits of results depend."""
LIBRARIES = ("numpy", "scipy", "pyarrow", "pint", "pyyaml", "jsonschema", "jinja2")


def versions() -> dict[str, str]:
    """Maps the name of each installed library to its version."""
    found = {
        "planrunner": __version__,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }
    return found | _libraries()


@functools.cache
def computed_with() -> dict[str, str]:
    """Returns everything that can affect the last digits of a result: the versions of planrunner, Python and the libraries, the
    processor, and the BLAS."""
    from threadpoolctl import threadpool_info

    blas = [item for item in threadpool_info() if item.get("user_api") == "blas"]
    named = sorted({" ".join(str(item.get(key)) for key in _BLAS if item.get(key)) for item in blas})
    found = {"planrunner": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for name in NUMERICAL:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found | {"blas": ", ".join(named)}


_BLAS = ("internal_api", "version", "architecture")


@functools.cache
def _libraries() -> dict[str, str]:
    """Returns the versions of the libraries. They are read once, because a process keeps the libraries that it has loaded."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
