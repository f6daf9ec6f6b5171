"""`python -m benchmarks [NAME…]`: runs the benchmarks and prints their tables; `--write` keeps them in benchmarks/README.md."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from importlib import import_module
from pathlib import Path

NAMES = (
    "check_speed",
    "executor_steps",
    "virtual_run",
    "least_squares_fit",
    "recording_memory",
    "allan",
    "monte_carlo",
    "inertial_stream",
    "strapdown",
    "navigation_72h",
    "tilted_scale_factor",
    "sensor_decoding",
    "sensor_streaming",
    "diagnosis",
)
START, END = "<!-- figures -->", "<!-- end of figures -->"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*NAMES, []], help="which (default: all)")
    parser.add_argument("--write", action="store_true", help="keep the figures in benchmarks/README.md")
    args = parser.parse_args()
    sections = {}
    for name in args.names or NAMES:
        print(f"running {name} …", file=sys.stderr)
        began = time.perf_counter()
        rows = import_module(f"benchmarks.{name}").run()
        sections[name] = table(name, rows, time.perf_counter() - began)
        print(sections[name])
    if args.write:
        keep(sections)
    return 0


def table(name: str, rows: dict[str, object], seconds: float) -> str:
    """One benchmark as Markdown: what was measured and the figure."""
    doc = (import_module(f"benchmarks.{name}").__doc__ or "").strip().splitlines()[0]
    lines = [f"### {name}", "", doc, "", "| what | figure |", "| --- | ---: |"]
    for what, figure in rows.items():
        lines.append(f"| {what} | {figure:.4g} |" if isinstance(figure, float) else f"| {what} | {figure} |")
    lines += ["", f"`python -m benchmarks {name}` took {seconds:.0f} s.", ""]
    return "\n".join(lines)


def keep(sections: dict[str, str]) -> None:
    """Writes the sections in the order of NAMES; those that were not run now stay as they were."""
    path = Path(__file__).with_name("README.md")
    before, _, rest = path.read_text(encoding="utf-8").partition(START)
    kept, _, after = rest.partition(END)
    earlier = {part.split("\n", 1)[0]: f"### {part}" for part in kept.split("### ")[1:]}
    machine = f"Python {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()} {platform.system()}."
    figures = [(earlier | sections).get(name, "") for name in NAMES]
    text = "\n".join(figure.rstrip() + "\n" for figure in figures if figure)
    path.write_text(f"{before}{START}\n{machine}\n\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
