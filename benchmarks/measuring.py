"""Tools of the benchmarks: they call a function in a separate process, measure the peak memory of a process, and write numbers in
short form.

The separate process is `python -m benchmarks.measuring MODULE FUNCTION ARGUMENTS`. It calls the function and prints the figures as
JSON.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
Figures = dict[str, Any]


class ProcessFailedError(Exception):
    """The process of a benchmark ended with an error. The text of the exception is the last line of its output."""


def figures_of(
    function: Callable[..., Figures],
    *arguments: float | str,
    separate: bool = True,
    environment: Mapping[str, str] | None = None,
) -> Figures:
    """Returns the figures that a function of a module measures. The function runs in a separate process, so that the memory and the
    threads of this process do not count.

    separate: if False, the function is called in this process, for tests with a small size. Raises `ProcessFailedError`.
    """
    if not separate:
        return function(*arguments)
    names = [function.__module__, function.__name__]
    command = [sys.executable, "-m", "benchmarks.measuring", *names, json.dumps(arguments)]
    done = subprocess.run(
        command, capture_output=True, encoding="utf-8", cwd=ROOT, env={**os.environ, **(environment or {})}
    )
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or ["it wrote nothing"]
        raise ProcessFailedError(f"{'.'.join(names)} ended with exit code {done.returncode}: {last[0]}")
    found: Figures = json.loads(done.stdout.splitlines()[-1])
    return found


def measured(name: str) -> Figures:
    """Returns the figures of a benchmark at its full size, by the name of the measured quantity."""
    found: Figures = import_module(f"benchmarks.{name}").run()
    return found


def peak_memory() -> float:
    """Returns the largest resident size of this process, MB; NaN if the system does not measure it."""
    # Linux's `ru_maxrss` remembers the parent's size, so `VmHWM` is read there.
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1e3
    try:
        import resource
    except ImportError:
        return math.nan
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def counted(number: float) -> str:
    """Writes a number in short form: 100000000 → '10⁸', 4000000 → '4·10⁶', 400 → '400'."""
    if number < 10_000:
        return f"{number:g}"
    digits, _, exponent = f"{number:.3e}".partition("e")
    power = str(int(exponent)).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    digits = digits.rstrip("0").rstrip(".")
    return f"10{power}" if digits == "1" else f"{digits}·10{power}"


if __name__ == "__main__":
    module, name, given = sys.argv[1:]
    print(json.dumps(getattr(import_module(module), name)(*json.loads(given))))
