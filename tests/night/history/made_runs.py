"""Run folders that are written without running anything: sealed, with stated coefficients, dates and circumstances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from planrunner.archive import formats
from planrunner.archive.provenance import versions
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.storage import Storage
from tests.archive.analyses import add_analysis

BEGIN = datetime(2024, 1, 1, 8, tzinfo=UTC)


@dataclass(frozen=True)
class MadeRun:
    """days: since `BEGIN`. values: coefficient → (value, standard uncertainty), in deg/h. limit: bounds of the first coefficient."""

    device: str = "D1"
    days: float = 0.0
    values: Mapping[str, tuple[float, float]] = field(default_factory=lambda: {"bias": (1.0, 0.1)})
    bench: str = "bench 1"
    laboratory: str = ""
    operator: str = ""
    firmware: str = ""
    mounting: str = ""
    plan: str = "calibration"
    limit: tuple[float, float] | None = None
    finished: bool = True
    analysed: bool = True


def make_run(archive: Path, made: MadeRun, number: int = 0) -> Path:
    """The folder of the run, `0000-calibration` and so on."""
    created = BEGIN + timedelta(days=made.days)
    name = f"{number:04d}-{made.plan}"
    info = {"device_serial": made.device, "operator": made.operator, "mounting": made.mounting}
    run = {
        "planrunner_run": formats.RUN_FORMAT,
        "run": name,
        "created": created.isoformat(),
        "plan": made.plan,
        "seed": None,
        "durability": "flushed",
        "versions": versions(),
        "info": {key: value for key, value in info.items() if value},
    }
    bench = f"planrunner_bench: 1\nname: {made.bench}\n"
    if made.laboratory:
        bench += f"laboratory: {{name: {made.laboratory}, address: somewhere}}\n"
    given = {
        "run.json": formats.to_bytes(run),
        "plan.yaml": f"planrunner: 1\ntitle: Title of {made.plan}\n".encode(),
        "bench.yaml": bench.encode(),
    }
    with RunWriter._build(archive, name, given, Storage("flushed")) as writer:
        writer.note("instruments", instruments={"table": {"model": "T", "firmware": made.firmware or "1.0"}})
        if made.finished:
            writer.finish()
    if made.analysed:
        add_results(writer.path, made)
    return writer.path


def add_results(run: Path, made: MadeRun) -> None:
    """One more analysis of the run."""
    coefficients = [
        {
            "name": name,
            "value": value,
            "unit": "deg/h",
            "standard_uncertainty": u,
            "degrees_of_freedom": "inf",
            "description": {"text": name},
            "role": "location",
        }
        for name, (value, u) in made.values.items()
    ]
    n = len(coefficients)
    estimate = {
        "name": "drift",
        "estimator": "scale_factor",
        "coefficients": coefficients,
        "covariance": [[0.0] * n for _ in range(n)],
        "headline": [],
        "settings": {},
        "tables": [],
        "plots": [],
        "notes": [],
        "warnings": [],
        "segments": [],
        "extra": {},
        "budgets": [],
    }
    limits = []
    if made.limit is not None:
        name, (value, u) = next(iter(made.values.items()))
        lower, upper = made.limit
        verdict = "pass" if lower <= value <= upper else "fail"
        limits.append(
            {
                "quantity": f"drift.{name}",
                "requirement": f"within {lower} to {upper}",
                "rule": "simple",
                "verdict": verdict,
                "value": value,
                "unit": "deg/h",
                "standard_uncertainty": u,
                "expanded_uncertainty": 2 * u,
                "coverage_factor": 2.0,
                "reason": "",
                "probability": 1.0,
                "lower": lower,
                "upper": upper,
            }
        )
    results = {
        "planrunner_results": 3,
        "origin": "simulated",
        "estimates": [estimate],
        "limits": limits,
        "failures": {},
        "segments": [],
    }
    add_analysis(run, {"results.json": formats.to_bytes(results)})


def make_series(
    archive: Path, values: Sequence[float], u: float = 0.1, made: MadeRun | None = None, every: float = 30.0
) -> None:
    """One run for each value, `every` days apart."""
    base = made or MadeRun()
    for number, value in enumerate(values):
        make_run(archive, replace(base, days=number * every, values={"bias": (value, u)}), number)
