"""The whole chain against theory: a virtual unit with constant errors and little noise, turned, navigated and compared, does what linear
equations and the harmonics of its cycle predict. Simulator, navigation and prediction share no formula."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from planrunner.cli import main

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_modulation_on_the_virtual_bench_is_what_theory_predicts(tmp_path: Path) -> None:
    bench = (ROOT / "plans" / "benches" / "virtual_imu.yaml").read_text(encoding="utf-8")
    for foreign in (
        r", towards: \{[^}]*\}",
        r", scale_factor_error: [-0-9]+ ppm",
        r"\n +(bias_instability|resolution): [^\n]*",
    ):
        bench, count = re.subn(foreign, "", bench)
        assert count
    bench = re.sub(r"angle_random_walk: \S+", "angle_random_walk: 0.0001", bench)
    bench = re.sub(r"velocity_random_walk: \S+", "velocity_random_walk: 0.0005", bench)
    (tmp_path / "constant.yaml").write_text(bench, encoding="utf-8")
    plan = (ROOT / "plans" / "rotation_stop_navigation.yaml").read_text(encoding="utf-8")
    for old, new in (("bench: virtual_imu", "bench: constant.yaml"), ("100 Hz", "10 Hz"), ("24 h", "12 h")):
        assert old in plan
        plan = plan.replace(old, new)
    path = tmp_path / "plan.yaml"
    path.write_text(plan, encoding="utf-8")
    information = ["--set", "device_serial=1", "--set", "operator=a"]
    assert main(["run", str(path), "--flushed", "--quiet", "--runs", str(tmp_path / "runs"), *information]) == 0
    (results,) = (tmp_path / "runs").glob("*/analyses/1/results.json")
    estimate = next(
        one for one in json.loads(results.read_text(encoding="utf-8"))["estimates"] if one["name"] == "rotation"
    )
    tables = {
        table["title"]: [
            dict(zip([column["title"] for column in table["columns"]], row, strict=True)) for row in table["rows"]
        ]
        for table in estimate["tables"]
    }
    uncertainty = {item["name"]: item["standard_uncertainty"] for item in estimate["coefficients"]}
    for row in tables["Residual of each cycle, and errors that repeat with it"]:
        # Second-order effects of turning beside the linear prediction: a few per cent.
        allowed = 0.03 * row["predicted position"] + 3 * uncertainty[f"modulation_{row['Navigation']}"]
        assert abs(row["position"] - row["predicted position"]) < allowed
        assert row["velocity"] == pytest.approx(row["predicted velocity"], rel=0.1)
    for row in tables["Position errors predicted from the declared constant errors"]:
        assert row["rms radial error"] == pytest.approx(row["predicted"], rel=0.1)
