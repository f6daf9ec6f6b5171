"""The commands `runs`, `history` and `compare`: what they print, their JSON, pages, exports and exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from planrunner.base.documents import JsonObject
from planrunner.base.workers import ALONE
from planrunner.cli import main
from planrunner.night.history.databases import INDEX
from planrunner.night.history.index import Index
from planrunner.night.history.trend import Trend, trend
from planrunner.reporting import history_page
from planrunner.reporting.history_tables import sentences
from planrunner.reporting.plots import drawing
from tests.night.history.made_runs import MadeRun, make_run

ROOT = Path(__file__).resolve().parents[3]
BASE = MadeRun(device="FG-7", limit=(-5.0, 5.0))


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve runs of a gyro whose level jumps by 1 deg/h with the firmware of the table, and one run of another."""
    archive = tmp_path_factory.mktemp("lab") / "runs"
    scatter = np.random.default_rng(7).normal(0, 0.1, 12)
    for k in range(12):
        late = k >= 8
        made = replace(
            BASE,
            days=30 * k,
            values={"bias": (1 + scatter[k] + late, 0.1), "slope": (2.0, 0.2)},
            bench=f"bench {1 + k % 2}",
            laboratory=["north", "south"][k % 2],
            operator=["ann", "bob"][k % 2],
            firmware="2.1" if late else "2.0",
        )
        make_run(archive, made, k)
    make_run(archive, replace(BASE, device="FG-8"), 12)
    return archive


@pytest.fixture(autouse=True)
def own_index(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(INDEX, str(tmp_path_factory.getbasetemp() / "commands.sqlite"))


def answer(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert main(list(words)) == code
    return capsys.readouterr().out


def valid(name: str, text: str) -> JsonObject:
    data: JsonObject = json.loads(text)
    Draft202012Validator(json.loads((ROOT / "schemas" / f"{name}.schema.json").read_bytes())).validate(data)
    return data


def test_runs_as_a_table_and_as_json(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = answer(capsys, "runs", str(archive), "--device", "FG-*", "--bench", "bench 2", "--limit", "2")
    assert "0011-calibration" in text and "0009-calibration" in text and "0010-calibration" not in text
    assert "6 runs, 2 shown" in text
    found = valid("runs", answer(capsys, "runs", str(archive), "--json"))
    assert found["total"] == 13 and found["faults"] == []


def test_a_damaged_folder_is_named_and_the_code_is_4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "runs", MadeRun())
    make_run(tmp_path / "runs", MadeRun(), 1)
    (run / "plan.yaml").write_text("changed")
    assert main(["runs", str(tmp_path / "runs")]) == 4
    said = capsys.readouterr()
    assert "1 run\n" in said.out and "not in the index: 0000-calibration: " in said.err


@pytest.mark.parametrize("words", [["history", "FG-7"], ["history", "FG-7", "drift.bias"], ["gauge", "drift.bias"]])
def test_a_result_without_a_damaged_run_says_so(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged, *_ = [make_run(tmp_path / "runs", MadeRun(device="FG-7"), number) for number in range(3)]
    assert main([*words, "--runs", str(tmp_path / "runs")]) == 0
    (damaged / "plan.yaml").write_text("changed")
    assert main([*words, "--runs", str(tmp_path / "runs")]) == 4
    assert "not in the index: 0000-calibration: " in capsys.readouterr().err


@pytest.mark.parametrize("words", [["history", "FG-7", "drift.bias"], ["gauge", "drift.bias"]])
def test_a_result_that_only_a_damaged_run_would_allow(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (make_run(tmp_path / "runs", MadeRun(device="FG-7")) / "plan.yaml").write_text("changed")
    assert main([*words, "--runs", str(tmp_path / "runs")]) == 2
    assert "not in the index: 0000-calibration: " in capsys.readouterr().err


def test_a_damaged_run_is_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [make_run(tmp_path / "runs", MadeRun(), number) for number in range(2)]
    (runs[0] / "plan.yaml").write_text("changed")
    assert main(["compare", *map(str, runs)]) == 4
    assert "plan.yaml: differs from what was recorded" in capsys.readouterr().err


def test_the_history_says_what_changed_and_why(
    archive: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    page = tmp_path / "history.html"
    words = ("history", "FG-7", "drift.bias", "--runs", str(archive))
    text = answer(capsys, *words, "--html", str(page), code=1)
    assert "The level changed by 1" in text and "between 2024-07-29 and 2024-08-28" in text
    assert "SIMULATED (12 of 12 runs): No item was measured" in text
    assert "these changed: firmware table: 2.0 → 2.1;" in text and "bench file" not in text
    assert "○" in text and "●" in text and "Agreement of laboratories" in text
    html = page.read_text(encoding="utf-8")
    assert (
        html.count("<svg") == 3
        and "SIMULATED (12 of 12 runs)" in html
        and "firmware table: 2.0 → 2.1" in html
        and "http-equiv" in html
    )
    found = valid("history", answer(capsys, *words, "--json", code=1))
    assert found["out_of_control"] is True
    (change,) = found["changes"]
    assert change["first_after"] == "0008-calibration" and change["causes"][0]["shared"] == 1.0


def test_the_history_begins_again_after_an_accepted_change(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("history", "FG-7", "drift.bias", "--runs", str(archive), "--since", "2024-08-01")
    text = answer(capsys, *words)
    assert "within all control limits" in text and "The level changed" not in text
    assert "too few values" in answer(capsys, *words[:-1], "2034-01-01")


def test_runs_of_different_devices_or_benches_are_no_repeats(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = [replace(BASE, values={"bias": (1.0 + k, 0.1)}) for k in range(2)]
    others = {
        "device": replace(made[1], device="FG-8"),
        "bench": replace(made[1], bench="bench 2"),
        "bench and laboratory": replace(made[1], bench="bench 2", laboratory="south"),
    }
    first = make_run(tmp_path, made[0], 0)
    for number, (what, one) in enumerate(others.items(), start=1):
        said = answer(capsys, "compare", str(first), str(make_run(tmp_path, one, number)), code=1)
        assert "too small for repeats" not in said
        assert f"The runs do not have the same {what}: the differences may be real." in " ".join(said.split())


def test_json_without_the_scatter_of_the_runs_remains_valid(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The key `scatter` was added to format 1: files of versions before it do not contain this key."""
    runs = [str(archive / f"{number:04d}-calibration") for number in (0, 8)]
    compared = valid("comparison", answer(capsys, "compare", *runs, "--json", code=1))
    for one in compared["coefficients"]:
        del one["scatter"]
    valid("comparison", json.dumps(compared))
    words = ("history", "FG-7", "drift.slope", "--runs", str(archive), "--json")
    history = valid("history", answer(capsys, *words))
    del history["scatter"]
    valid("history", json.dumps(history))


def test_names_are_listed_and_corrected(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert answer(capsys, "history", "FG-7", "--runs", str(archive)) == "drift.bias\ndrift.slope\n"
    assert main(["history", "FG-9", "drift.bias", "--runs", str(archive)]) == 2
    assert "did you mean 'FG-" in capsys.readouterr().err
    assert main(["history", "FG-7", "drift.bia", "--runs", str(archive)]) == 2
    assert "did you mean 'drift.bias'?" in capsys.readouterr().err
    for tolerance in ("5 K", "-1 deg/h", "much"):
        assert main(["history", "FG-7", "drift.bias", "--runs", str(archive), f"--tolerance={tolerance}"]) == 2
        assert "not a permissible deviation in deg/h" in capsys.readouterr().err


def test_the_next_calibration_uses_the_tolerance_in_any_unit(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    due = []
    for tolerance in ("1 deg/h", "1 arcsec/s", "0.1 deg/h"):
        words = ("history", "FG-7", "drift.slope", "--runs", str(archive), "--tolerance", tolerance, "--json")
        found = valid("history", answer(capsys, *words))
        due.append(found["drift"]["next_calibration"])
    assert due[0] == due[1] and due[2] == "2024-11-26T08:00:00+00:00"  # the uncertainty of 0.4 exceeds 0.1 at once


def test_runs_are_compared(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """drift.bias differs by about 1 with U = 0.2 each: E_n is about 3.5. drift.slope is the same."""
    runs = [str(archive / f"{number:04d}-calibration") for number in (0, 8)]
    found = valid("comparison", answer(capsys, "compare", *runs, "--json", code=1))
    bias, slope = found["coefficients"]
    values = [one["value"] for one in bias["values"]]
    assert bias["largest_en"] == pytest.approx(abs(values[1] - values[0]) / (2 * np.hypot(0.1, 0.1)))
    assert slope["largest_en"] == 0.0
    assert bias["scatter"]["ratio"] == pytest.approx(abs(values[1] - values[0]) / np.hypot(0.1, 0.1))
    assert slope["scatter"]["chance"] == 1.0
    said = answer(capsys, "compare", *runs, code=1)
    assert "drift.bias (6.7 times)" in said and "uncertainties are too small for repeats" in said
    assert "largest |E_n|" in answer(capsys, "compare", *runs, code=1)
    answer(capsys, "compare", runs[0], runs[0])
    assert main(["compare", runs[0]]) == 2 and main(["compare", runs[0], str(archive)]) == 2


@pytest.mark.parametrize("name", ["index.duckdb", "parquet"])
def test_the_export_has_all_tables(
    archive: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str
) -> None:
    duckdb = pytest.importorskip("duckdb")
    for _ in range(2):  # the second one replaces the first
        answer(capsys, "runs", str(archive), "--export", str(tmp_path / name), "--limit", "1")
    connection = duckdb.connect(str(tmp_path / name) if name.endswith(".duckdb") else ":memory:")
    table = (lambda t: t) if name.endswith(".duckdb") else (lambda t: f"'{tmp_path / name / t}.parquet'")
    question = f"""SELECT count(*), min(created), sum(value) FROM {table("runs")} JOIN {table("coefficients")} USING (folder)
                   WHERE quantity = 'drift.bias' AND device = 'FG-7'"""
    count, first, total = connection.execute(question).fetchone()
    connection.close()
    with Index.open(archive) as index:
        expected = [point.coefficient.value for point in index.history("FG-7", "drift.bias")]
    assert (count, first.year, total) == (12, 2024, pytest.approx(sum(expected)))
    assert sorted(path.name for path in tmp_path.iterdir()) == [name]


def test_a_gauge_study_of_an_archive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two devices × two operators, twice; worked by hand: the values are 0, 2 | 4, 6 for one operator and the same + 10 for the other.
    MS of devices 32, of operators 200, of the interaction 0, of repetitions 2."""
    runs = tmp_path / "runs"
    for number in range(8):
        device, operator, repetition = number % 2, number // 2 % 2, number // 4
        values = {"bias": (4.0 * device + 10.0 * operator + 2.0 * repetition, 0.1)}
        made = MadeRun(device=f"D{device}", operator=["ann", "bob"][operator], values=values, days=number)
        make_run(runs, made, number)
    found = valid("gauge", answer(capsys, "gauge", "drift.bias", "--runs", str(runs), "--json"))
    assert [one["sum_of_squares"] for one in found["anova"]] == pytest.approx([32.0, 200.0, 0.0, 8.0])
    variances = {one["name"]: one["variance"] for one in found["components"]}
    assert variances["repeatability"] == pytest.approx(2.0) and variances["operator"] == pytest.approx(50.0)
    assert variances["device"] == pytest.approx(8.0) and found["repetitions"] == 2 and found["unit"] == "deg/h"
    text = answer(capsys, "gauge", "drift.bias", "--runs", str(runs))
    assert "2 devices, 2 operators, 2 runs of each" in text and "gauge R&R" in text
    make_run(runs, MadeRun(device="D2", operator="ann"), 8)
    assert main(["gauge", "drift.bias", "--runs", str(runs)]) == 2
    assert "no value of device D2, operator bob" in capsys.readouterr().err
    assert main(["gauge", "drift.none", "--runs", str(runs)]) == 2
    assert "no run has a coefficient 'drift.none'" in capsys.readouterr().err


# -- the trend itself --------------------------------------------------------------------------------------------------


def history_of(tmp_path: Path, values: list[float], days: list[float] | None = None) -> Trend:
    days = days or [30.0 * k for k in range(len(values))]
    for number, (value, day) in enumerate(zip(values, days, strict=True)):
        make_run(tmp_path / "runs", replace(BASE, days=day, values={"bias": (value, 0.1)}), number)
    with Index.open(tmp_path / "runs", str(tmp_path / "index")) as index:
        index.refresh(workers=ALONE)
        return trend("FG-7", "drift.bias", index.history("FG-7", "drift.bias"))


def test_a_drift_is_no_series_of_changes(tmp_path: Path) -> None:
    scatter = np.random.default_rng(3).normal(0, 0.1, 24)
    found = history_of(tmp_path, [0.05 * k + float(scatter[k]) for k in range(24)])
    assert found.changes == () and found.drift is not None and found.drift.significant
    assert found.drift.slope * 30 == pytest.approx(0.05, abs=3 * 30 * found.drift.slope_uncertainty)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "span", [0.02, 900.0, pytest.param(60.0, marks=pytest.mark.slow), pytest.param(1100.0, marks=pytest.mark.slow)]
)
def test_charts_have_dates_over_any_span(span: float, tmp_path: Path) -> None:
    found = history_of(tmp_path, [1.0, 1.1, 1.0], [0.0, span / 2, span])
    assert history_page.render_history(found).count("<svg") >= 3


@pytest.mark.parametrize(
    ("days", "what"),
    [
        ([0.0, 0.01, 0.02, 0.25], "too short a span (4 runs within 6 h)"),
        ([0.0, 40.0], "too few values (2 runs within 40 d)"),
        ([0.0, 0.0, 0.0], "too short a span (3 runs)"),
    ],
)
def test_a_history_that_is_too_short_says_what_is_needed(days: list[float], what: str, tmp_path: Path) -> None:
    found = history_of(tmp_path, [1.0, 1.1, 1.0, 1.2][: len(days)], days)
    said = " ".join(sentences(found))
    assert (
        f"No drift and no date of the next calibration: {what}. At least 3 runs over at least 1 day are needed." in said
    )
    assert "per year" not in said and found.to_json()["drift"] is None and found.next_calibration is None


def test_values_without_number_are_left_out(tmp_path: Path) -> None:
    make_run(tmp_path / "runs", replace(BASE, values={"bias": ("nan", 0.1)}, days=5, limit=None), 7)  # type: ignore[dict-item]
    found = history_of(tmp_path, [1.0, 1.1])
    assert found.values == (1.0, 1.1) and found.left_out == ("0007-calibration",)


def test_the_legends_of_the_charts_cover_no_value_and_are_not_cut(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn, draw = [], drawing

    @contextmanager
    def observed(width: float, height: float) -> Iterator[tuple[Figure, Callable[[str, str, str], str]]]:
        with draw(width, height) as (figure, save):
            yield figure, save
        drawn.append(figure)

    monkeypatch.setattr(history_page, "drawing", observed)
    monkeypatch.setenv(INDEX, str(tmp_path / "index.sqlite"))
    page = tmp_path / "page.html"
    assert main(["history", "FG-7", "drift.bias", "--runs", str(archive), "--html", str(page), "--quiet"]) in (0, 1)
    assert len(drawn) == 3  # values, moving average, sums
    for figure in drawn:
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        (axes,) = figure.axes
        legend = axes.get_legend()
        assert legend is not None
        words = [text.get_window_extent(canvas.get_renderer()) for text in legend.get_texts()]
        top = axes.get_window_extent().y1
        assert all(word.y0 >= top for word in words)
        assert all(word.x1 <= figure.bbox.x1 and word.y1 <= figure.bbox.y1 for word in words)
