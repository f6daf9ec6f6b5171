"""Runs a real set as a user does, `planrunner run` and `planrunner diagnose`, and reads what the commands write."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scipy.stats import t

from planrunner.cli import main
from tests.real_sets.sets import RealSet

TRACEBACK = "Traceback"


@dataclass(frozen=True)
class Value:
    """A coefficient with its standard uncertainty and its expanded uncertainty, in `unit`."""

    value: float
    u: float
    expanded: float
    unit: str


@dataclass(frozen=True)
class Found:
    """What planrunner says of a set. values: by `estimate.coefficient`; warnings: of all estimates; errors: of the run, as printed;
    verdict: kind, effects, members and sentence of the diagnosis; diagnosis: all of it, None without one."""

    values: dict[str, Value] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    errors: str = ""
    diagnosis: dict[str, Any] | None = None
    diagnosis_error: str = ""


def command(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output and error output of a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(arguments))
    assert TRACEBACK not in err.getvalue(), err.getvalue()
    return code, out.getvalue(), err.getvalue()


def laid_out(one: RealSet, data: Path, folder: Path) -> Path:
    """The plan, its bench and its data in a folder; returns the plan."""
    for name in one.files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(data / name, folder / name)
    if one.segments is not None:
        (folder / "segments.csv").write_text(one.segments(data), encoding="utf-8")
    (folder / "real.bench.yaml").write_text(one.bench, encoding="utf-8")
    text = "\n".join(
        "bench: ./real.bench.yaml" if line.startswith("bench:") else line for line in one.plan.splitlines()
    )
    (folder / "real.yaml").write_text(text + "\n", encoding="utf-8")
    return folder / "real.yaml"


def found(one: RealSet, data: Path) -> Found:
    """Estimates and diagnosis of a set."""
    with TemporaryDirectory(prefix="real-") as name:
        folder = Path(name)
        plan = str(laid_out(one, data, folder))
        code, _, err = command("run", plan, "--data", name, "--quiet", "--flushed", "--runs", str(folder / "runs"))
        values: dict[str, Value] = {}
        warnings: list[str] = []
        for file in sorted((folder / "runs").glob("*/analyses/1/results.json")):
            results = json.loads(file.read_text(encoding="utf-8"))
            for estimate in results["estimates"]:
                warnings += [one["text"] if isinstance(one, dict) else one for one in estimate["warnings"]]
                for item in estimate["coefficients"]:
                    u, degrees = float(item["standard_uncertainty"]), float(item["degrees_of_freedom"])
                    values[f"{estimate['name']}.{item['name']}"] = Value(
                        float(item["value"]), u, float(t.ppf(0.975, degrees)) * u, item["unit"]
                    )
        made, problem = None, ""
        if one.nominal is not None:
            run = next((folder / "runs").glob("2*"), None)
            where = [str(run)] if run is not None and code == 0 else [plan, "--recording", str(folder / one.files[0])]
            code_2, out, err_2 = command("diagnose", *where, "--json", "--nominal", *one.nominal)
            made, problem = (json.loads(out), "") if code_2 == 0 else (None, err_2)
        return Found(values, tuple(warnings), "" if code == 0 else err, made, problem)
