"""Speed of `check`: 100 distinct plans in one process, and one plan in a process of its own."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PLAN = Path(__file__).resolve().parents[1] / "plans" / "flexure_gyro_eight_position.yaml"


def distinct(count: int, folder: Path) -> list[Path]:
    """Copies of the flagship plan that differ in title, dwell and temperature."""
    text = PLAN.read_text(encoding="utf-8")
    paths = []
    for number in range(count):
        own = text.replace("title: ", f"title: {number} ").replace("dwell: 2 min", f"dwell: {100 + number} s")
        own = re.sub(r"temperature: 25 degC", f"temperature: {20 + number / 10} degC", own)
        paths.append(folder / f"plan{number:03d}.yaml")
        paths[-1].write_text(own, encoding="utf-8")
    return paths


def process(*command: str) -> float:
    """Best of seven runs of a process, s."""
    times = []
    for _ in range(7):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - began)
    return min(times)


def run() -> dict[str, object]:
    from planrunner.checking import check_plan

    with tempfile.TemporaryDirectory() as folder:
        paths = distinct(100, Path(folder))
        began = time.perf_counter()
        sound = sum(check_plan(path).ok for path in paths)
        together = time.perf_counter() - began
    assert sound == 100
    whole = process(sys.executable, "-m", "planrunner", "check", str(PLAN))
    imports = process(sys.executable, "-c", "import yaml, jsonschema")
    return {
        "100 distinct plans in one process [s]": together,
        "`planrunner check` of one plan, whole process [s]": whole,
        '`python -c "import yaml, jsonschema"` [s]': imports,
        "ratio (target ≤ 4)": whole / imports,
    }
