"""A table of means in place of a recording: what it gives, what is refused, and what is said of tables that are not as they should be."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from planrunner.archive.run_reader import RunReader
from planrunner.tasks.estimate import sound_run
from tests.in_process import planrunner

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "published_table"
TABLE = (EXAMPLE / "rates.csv").read_text(encoding="utf-8")
BENCH = (EXAMPLE / "bench.yaml").read_text(encoding="utf-8")
PLAN = (EXAMPLE / "plan.yaml").read_text(encoding="utf-8")


def written(folder: Path, table: str = TABLE, bench: str = BENCH, plan: str = PLAN) -> Path:
    for name, text in (("rates.csv", table), ("bench.yaml", bench), ("plan.yaml", plan)):
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "plan.yaml"


def run(folder: Path, **texts: str) -> tuple[Path, dict[str, dict[str, float]]]:
    """The run folder and the coefficients of the first estimate."""
    done = planrunner("run", written(folder, **texts), "--data", folder, "--quiet", cwd=folder)
    assert done.returncode == 0, done.stderr
    (made,) = (folder / "runs").iterdir()
    results = json.loads((made / "analyses" / "1" / "results.json").read_text(encoding="utf-8"))
    (estimate,) = results["estimates"]
    return made, {one["name"]: one for one in estimate["coefficients"]}


def test_a_line_through_published_means(tmp_path: Path) -> None:
    """Against weighted least squares with weights n/s², the noise of a row."""
    folder, found = run(tmp_path)
    rows = np.genfromtxt(EXAMPLE / "rates.csv", delimiter=",", skip_header=1)
    rates = np.array([0, 10, -10, 50, -50, 100, -100.0])
    u = rows[:, 3] / np.sqrt(rows[:, 1])
    line = np.polynomial.polynomial.polyfit(rates, rows[:, 2], 1, w=1 / u)
    assert found["K_gyro_z"]["value"] == pytest.approx(line[1], rel=1e-9)
    checked = planrunner("estimate", folder, cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    again = planrunner("report", folder, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    refused = planrunner("diagnose", folder, cwd=tmp_path)
    assert refused.returncode == 2 and "give the recorded samples, not their means" in refused.stderr


def test_a_row_has_the_uncertainty_of_its_samples(tmp_path: Path) -> None:
    plan = PLAN.replace(
        'scale: {estimator: scale_factor, segments: "*", outputs: [gyro_z]}',
        'scale: {estimator: error_model, outputs: {gyro_z: [gyro_bias, gyro_scale_factor]}, uncertainty: within_segment, segments: "*"}',
    )  # fmt: skip
    assert plan != PLAN
    _, found = run(tmp_path, plan=plan)
    rows = np.genfromtxt(EXAMPLE / "rates.csv", delimiter=",", skip_header=1)
    rates = np.array([0, 10, -10, 50, -50, 100, -100.0])
    matrix = np.column_stack([np.ones(7), rates]) * (np.sqrt(rows[:, 1]) / rows[:, 3])[:, None]
    spread = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    bias, scale = found["gyro_bias_z"], found["gyro_scale_factor_z"]
    # The noise within the segments may be pooled where it does not differ: by up to the four per cent by which the deviations do.
    assert bias["standard_uncertainty"] == pytest.approx(spread[0], rel=0.05)
    assert scale["standard_uncertainty"] == pytest.approx(spread[1] * 1e6, rel=0.05)
    assert bias["degrees_of_freedom"] is None or bias["degrees_of_freedom"] > 10_000


def test_a_stated_standard_error_is_used(tmp_path: Path) -> None:
    lines = TABLE.splitlines()
    table = "\n".join([lines[0] + ",u", *(line + ",0.004" for line in lines[1:])]) + "\n"
    bench = BENCH.replace("standard_deviation: sd_deg_per_s", "standard_error: u, sign: -1")
    folder, _ = run(tmp_path, table=table, bench=bench)
    reader = RunReader.open(folder)

    for one in reader.recording(sound_run(reader).schedule):
        assert one.statistics.standard_error == pytest.approx([0.004], rel=1e-12)
        assert one.units == {"gyro_z": "deg/s"} and one.statistics.duration == pytest.approx(one.statistics.count / 100)
        if one.label == "+10":
            assert one.statistics.mean == pytest.approx([-10.0164]) and one.statistics.count == 12000
            assert one.statistics.start == pytest.approx(600.0)


@pytest.mark.parametrize(
    "plan",
    [
        "noise: {estimator: allan_deviation, segments: rest}",
        "curve: {estimator: temperature_model, segments: rest, channels: [gyro_z], temperature_channel: chip, order: 0}",
    ],
)
def test_estimators_that_need_samples_refuse_before_a_run(tmp_path: Path, plan: str) -> None:
    text = PLAN.replace('scale: {estimator: scale_factor, segments: "*", outputs: [gyro_z]}', plan)
    bench = BENCH + "      chip: {column: mean_deg_per_s, standard_deviation: sd_deg_per_s, unit: degC}\n"
    done = planrunner("check", written(tmp_path, plan=text, bench=bench), "--data", tmp_path, cwd=tmp_path)
    assert done.returncode == 2 and "[recording-estimate]" in done.stderr
    assert "'rest' is a row of a table" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("table", "bench", "words"),
    [
        (TABLE.replace("+50,", "+51,"), BENCH, "rates.csv has no row '+50'"),
        (TABLE.replace("state,n", "state,count"), BENCH, "rates.csv has no column 'n'"),
        (TABLE.replace("0.0508", "about 0.05"), BENCH, "rates.csv, line 3: 'about 0.05' in column 'sd_deg_per_s' is not a number"),
        (TABLE.replace("0.0508", "-0.0508"), BENCH, "line 3: -0.0508 in column 'sd_deg_per_s' is negative"),
        (TABLE.replace("60000", "60000.5"), BENCH, "line 2: 60000.5 in column 'n' is not a number of samples"),
        (TABLE.replace("60000", "0"), BENCH, "line 2: 0 in column 'n' is not a number of samples"),
        (TABLE.replace("-10,12000,-9.9918", "+10,12000,-9.9918"), BENCH, "line 4: the label '+10' appears twice"),
        (TABLE.replace("rest,", ","), BENCH, "line 2: the label is empty"),
        (TABLE.splitlines()[0], BENCH, "contains no rows"),
        (TABLE.replace("10.0164", "nan"), BENCH, "line 3: 'nan' in column 'mean_deg_per_s' is not a number"),
        (TABLE, BENCH.replace("standard_deviation: sd_deg_per_s, ", ""), "needs one column of its scatter"),
        (TABLE, BENCH.replace("    kind: gyro\n", "    kind: gyro\n    pauses: 3 s\n"), "`pauses` belongs to a recording of samples"),
        (TABLE, BENCH.replace("    summary: {label: state, count: n}\n", ""), "which column of rates.csv is the time"),
    ],
)  # fmt: skip
def test_tables_that_are_not_as_they_should_be(tmp_path: Path, table: str, bench: str, words: str) -> None:
    done = planrunner("check", written(tmp_path, table, bench), "--data", tmp_path, cwd=tmp_path)
    assert done.returncode == 2 and words in " ".join(done.stderr.split())


def test_a_mean_cannot_be_divided(tmp_path: Path) -> None:
    plan = PLAN.replace("dwell: recorded", "dwell: 60 s")
    done = planrunner("check", written(tmp_path, plan=plan), "--data", tmp_path, cwd=tmp_path)
    assert done.returncode == 2 and "a mean cannot be divided; write `dwell: recorded`" in " ".join(done.stderr.split())
    assert "describes 6000 samples" not in done.stderr  # these last 60 s


def test_one_sample_has_no_scatter(tmp_path: Path) -> None:
    """Rows of one sample each: the residuals about the line are all that is known."""
    table = "\n".join(
        [TABLE.splitlines()[0], *(f"{one.split(',')[0]},1,{one.split(',')[2]},0" for one in TABLE.splitlines()[1:])]
    )
    _, found = run(tmp_path, table=table)
    assert math.isfinite(found["K_gyro_z"]["standard_uncertainty"])
