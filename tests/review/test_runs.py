"""The significance of differences between runs, against hand-worked numbers and published tables."""

from __future__ import annotations

import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.review.runs import RunDifference, run_difference
from planrunner.uncertainty.influences import Budget, BudgetLine
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]


def line(contribution: float, sensitivity: float = 1.0, source: str = "survey", count: int = 1) -> BudgetLine:
    u = abs(contribution / sensitivity)
    return BudgetLine(
        "azimuth", "B", 0.0, "deg", u, "normal", math.inf, sensitivity, abs(contribution), source, count=count
    )


def estimate(
    value: float, u: float, freedom: float = math.inf, lines: tuple[BudgetLine, ...] = ()
) -> dict[str, Estimate]:
    item = Coefficient("b", value, "deg/h", u, freedom)
    budget = Budget("b", "deg/h", lines, u, freedom, 2.0)
    return {"d": Estimate("d", "e", (item,), np.array([[u**2]]), budgets=(budget,))}


def test_independent_results() -> None:
    """u = √(3² + 4²) = 5; p of 1.96 standard uncertainties is 0.05."""
    (found,) = run_difference(estimate(10, 3), estimate(19.8, 4), same_bench=True).coefficients
    assert found.difference == pytest.approx(9.8)
    assert (found.standard_uncertainty, found.common) == (5.0, 0.0)
    assert found.p == pytest.approx(0.05, abs=1e-5)


def test_an_error_in_common_cancels() -> None:
    """u² = 5² + 5² − 2·4·4 = 18; both own parts have the variance 9 with 10 degrees of freedom, so ν = 18²/(2·9²/10) = 20, and Student's
    t of 2.086 has p = 0.05."""
    one, other = estimate(0, 5, 10, (line(4),)), estimate(2.086 * math.sqrt(18), 5, 10, (line(4),))
    (found,) = run_difference(one, other, same_bench=True).coefficients
    assert found.standard_uncertainty == pytest.approx(math.sqrt(18))
    assert found.degrees_of_freedom == pytest.approx(20)
    assert found.common == pytest.approx(32 / 50)
    assert found.p == pytest.approx(0.05, abs=2e-5)


@pytest.mark.parametrize(
    ("lines", "same_bench", "variance"),
    [
        ((line(4, 1.0), line(4, -1.0)), True, 50 + 32),  # with opposite signs it adds up
        ((line(4), line(4, source="another survey")), True, 50),
        ((line(4, count=8), line(4, count=8)), True, 50),  # eight independent errors
        ((line(4), line(4)), False, 50),
    ],
)
def test_what_is_in_common(lines: tuple[BudgetLine, BudgetLine], same_bench: bool, variance: float) -> None:
    one, other = estimate(0, 5, lines=lines[:1]), estimate(1, 5, lines=lines[1:])
    (found,) = run_difference(one, other, same_bench).coefficients
    assert found.standard_uncertainty**2 == pytest.approx(variance)


def test_holm() -> None:
    """p of 0.01, 0.04, 0.03 and 0.005 become 0.03, 0.06, 0.06 and 0.02 (Holm 1979: ordered and multiplied by 4, 3, 2, 1)."""
    from statistics import NormalDist

    stated = (0.01, 0.04, 0.03, 0.005)
    before = {f"e{k}": estimate(0, 1)["d"] for k in range(4)}
    after = {f"e{k}": estimate(math.sqrt(2) * NormalDist().inv_cdf(1 - p / 2), 1)["d"] for k, p in enumerate(stated)}
    found = run_difference(before, after, same_bench=True).coefficients
    assert [item.p for item in found] == pytest.approx(stated)
    assert [item.holm for item in found] == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_coefficients_of_one_run_only() -> None:
    found = run_difference(estimate(0, 1), {}, same_bench=True)
    assert found == RunDifference((), (("d.b",), ()))


@pytest.mark.slow
def test_two_runs(tmp_path: Path) -> None:
    """Of one simulated sensor: everything is listed, and nothing is significant."""
    text = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    for name, dwell in (("a", "10 s"), ("b", "12 s")):
        plan = tmp_path / f"{name}.yaml"
        plan.write_text(text.replace("dwell: 2 min", f"dwell: {dwell}"), encoding="utf-8")
        words = ("--set", "device_serial=1", "--set", f"operator={name}", "--quiet", "--flushed", "--runs", name)
        assert planrunner("run", plan, *words, cwd=tmp_path).returncode in (0, 1)
    runs = [next(path for path in (tmp_path / name).iterdir() if path.is_dir()) for name in "ab"]
    done = planrunner("diff", *runs, "--json", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    found = json.loads(done.stdout)
    jsonschema.validate(found, json.loads((ROOT / "schemas" / "difference.schema.json").read_text(encoding="utf-8")))
    assert {"name": "operator", "before": "a", "after": "b"} in found["facts"]
    assert {tuple(change["place"]) for one in found["segments"] for change in one["changes"]} == {("dwell",)}
    ps = [one["p_holm"] for one in found["coefficients"] if one["p_holm"] is not None]
    assert len(ps) > 20 and min(ps) > 0.01
    assert planrunner("diff", runs[0], runs[0], cwd=tmp_path).returncode == 0
    page = planrunner("diff", *runs, "--html", "page.html", cwd=tmp_path)
    assert page.returncode == 1 and (tmp_path / "page.html").stat().st_size > 10_000
