"""The static site of an archive, opened from files in a browser: wall, filters, coefficients, reports, hostile names, accessibility."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from playwright.sync_api import expect

from planrunner.base.findings import InputError
from planrunner.night import site
from planrunner.night.history.index import Index
from planrunner.night.history.rows import CoefficientRow, IndexedRun, LimitRow, RunRow
from planrunner.night.site import build_site
from tests.browser import chromium, opened, overhang, violations
from tests.in_process import planrunner
from tests.night.synthetic_archive import HOSTILE, filled

CALL = re.compile(r'planrunnerData\("([\w-]+)",(.*)\);\n')


def data_of(site: Path) -> dict[str, Any]:
    """What the scripts hand to the page."""
    match = CALL.fullmatch((site / "data.js").read_text(encoding="ascii"))
    assert match is not None
    entry = json.loads(match[2])
    found: dict[str, Any] = {"entry": entry}
    for file in (site / entry["data"]).iterdir():
        match = CALL.fullmatch(file.read_text(encoding="ascii"))
        assert match is not None and file.name == f"{match[1]}.js"
        found[match[1]] = json.loads(match[2])
    return found


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    (tmp_path / "runs").mkdir()
    with Index.open(tmp_path / "runs", str(tmp_path / "index.sqlite")) as opened:
        yield opened


def test_every_run_is_in_the_site_the_newest_first(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(site, "CHUNK", 20)
    filled(index, 25)
    built = build_site(index, tmp_path / "site")
    found = data_of(tmp_path / "site")
    chunks = [found["runs-0"], found["runs-1"]]
    rows = [row for chunk in chunks for row in chunk]
    assert built.runs == len(rows) == 25 and len(chunks[1]) == 5
    assert [row[0] for row in rows] == [run.folder for run in index.runs()]
    assert {name for name in found if name.startswith("device-")} == {f"device-{k}" for k in range(built.devices)}


def test_a_coefficient_has_its_values_and_limits_in_order(index: Index, tmp_path: Path) -> None:
    def run(day: int, value: float) -> IndexedRun:
        folder = f"2026010{day}T000000Z-drift-00000{day}"
        row = RunRow(
            folder,
            folder,
            f"2026-01-0{day}T00:00:00.000000+00:00",
            "drift",
            "",
            "A",
            "b",
            "",
            "",
            "",
            "sealed",
            "pass",
            1,
            0,
        )
        limit = LimitRow("drift.D", "within ±0.5 deg/h", "pass", "deg/h", -0.5, 0.5, 0.95)
        return IndexedRun(folder, "", row, (CoefficientRow("drift.D", value, "deg/h", 0.25, 9.0),), (limit,))

    index._write([run(1, 1.0), run(2, 2.0), run(3, float("nan"))])
    build_site(index, tmp_path / "site")
    (series,) = data_of(tmp_path / "site")["device-0"]
    assert (series["quantity"], series["unit"], series["run"]) == ("drift.D", "deg/h", [2, 1, 0])
    assert series["value"] == [1.0, 2.0, None] and series["u"] == [0.25] * 3
    assert series["plan_lower"] == [-0.5] * 3 and series["plan_upper"] == [0.5] * 3


def test_control_limits_are_those_of_the_handbook(index: Index, tmp_path: Path) -> None:
    """Without stated uncertainty: mean ± 3 MR/1.128 (NIST/SEMATECH e-Handbook, 6.3.2.2, with its example of ten flow rates)."""
    rates = (49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1)
    rows = []
    for day, rate in enumerate((*rates, float("nan")), 1):
        folder = f"202601{day:02d}T000000Z-flow-{day:06d}"
        created = f"2026-01-{day:02d}T00:00:00.000000+00:00"
        row = RunRow(folder, folder, created, "flow", "", "A", "b", "", "", "", "sealed", "none", 1, 0)
        rows.append(IndexedRun(folder, "", row, (CoefficientRow("flow.rate", rate, "l/h", 0.0, 9.0),)))
    index._write(rows)
    build_site(index, tmp_path / "site")
    (series,) = data_of(tmp_path / "site")["device-0"]
    assert series["control_lower"][:10] == pytest.approx([45.8] * 10, abs=0.06)  # 50.81 - 3 * 1.8778 / 1.128
    assert series["control_upper"][:10] == pytest.approx([55.8] * 10, abs=0.06)
    assert series["control_lower"][10] is series["control_upper"][10] is None


def test_a_site_is_replaced_and_nothing_else_is(index: Index, tmp_path: Path) -> None:
    place = tmp_path / "site"
    filled(index, 3)
    build_site(index, place)
    first = {path.name for path in place.iterdir()}
    (place / "notes.txt").write_text("mine", encoding="utf-8")
    filled(index, 4)
    build_site(index, place)
    second = {path.name for path in place.iterdir()}
    assert (place / "notes.txt").exists() and len([name for name in second if name.startswith("data-")]) == 1
    assert first != second - {"notes.txt"}
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="not empty"):
        build_site(index, other)
    assert [path.name for path in other.iterdir()] == ["notes.txt"]


def test_an_empty_archive_and_a_damaged_night(index: Index, tmp_path: Path) -> None:
    night = tmp_path / "runs" / "nights" / "20260101T000000Z-night-000000"
    night.mkdir(parents=True)
    (night / "night.json").write_text('{"planrunner_night": 1}', encoding="utf-8")
    assert build_site(index, tmp_path / "site").runs == 0
    entry = data_of(tmp_path / "site")["entry"]
    assert entry["nights"] == [] and entry["chunks"] == 0


@pytest.mark.slow
def test_the_command_makes_the_site_of_real_runs(tmp_path: Path) -> None:
    """With a link to every report, which exists."""
    given = ("--set", "device_serial=FG-7", "--set", "operator=test", "--quiet", "--flushed")
    assert planrunner("run", SHIPPED, *given, cwd=tmp_path).returncode == 0
    done = planrunner("site", "runs", "site", "--index", "index.sqlite", cwd=tmp_path)
    assert done.returncode == 0 and done.stdout.strip() == str(Path("site/index.html"))
    found = data_of(tmp_path / "site")
    (row,) = found["runs-0"]
    assert row[4] == "FG-7" and "report.html" in row[12]
    for name in row[12]:
        assert (
            (tmp_path / "site" / found["entry"]["link"] / row[0] / "analyses" / str(row[9]) / name).resolve().is_file()
        )
    again = planrunner("site", "nowhere", "site", cwd=tmp_path)
    assert again.returncode == 2 and "Traceback" not in again.stderr


SHIPPED = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"


@pytest.mark.slow
def test_the_pages_in_a_browser(index: Index, tmp_path: Path) -> None:
    expect.set_options(timeout=120_000)
    filled(index, 300)
    page_file = build_site(index, tmp_path / "site").page
    with chromium() as browser:
        for scheme, width in (("light", 1200), ("dark", 380)):
            with opened(browser, page_file.as_uri(), "dark" if scheme == "dark" else "light", width) as page:
                expect(page.get_by_role("heading", name="Last night")).to_be_visible()
                assert violations(page) == [] and overhang(page) <= 0
                page.get_by_role("link", name="Runs").click()
                expect(page.get_by_role("status").filter(has_text="300 runs; 1 to 100 are shown")).to_be_visible()
                page.get_by_role("button", name="Older").click()
                expect(page.get_by_text("101 to 200 are shown")).to_be_visible()
                page.get_by_label("Verdict").select_option("fail")
                failed = sum(run.verdict == "fail" for run in index.runs())
                expect(page.get_by_text(f"{failed} runs; 1 to")).to_be_visible()
                page.get_by_label("Search").fill("fg-0007")
                own = sum(run.verdict == "fail" and run.device == "FG-0007" for run in index.runs())
                expect(page.locator("tbody tr")).to_have_count(own)
                assert violations(page) == [] and overhang(page) <= 0
                page.get_by_role("link", name="Devices").click()
                page.get_by_label("Search devices").fill("FG-0007")
                page.get_by_role("link", name="FG-0007").click()
                expect(page.get_by_role("heading", name="Device FG-0007")).to_be_visible()
                expect(page.locator("canvas")).to_have_count(3)
                page.get_by_label("Coefficient").select_option(label="drift.D_Y_F, deg/h")
                expect(page.get_by_role("img").first).to_have_attribute("aria-label", re.compile("drift.D_Y_F"))
                assert violations(page) == [] and overhang(page) <= 0
                page.get_by_role("link", name="Benches").click()
                expect(page.get_by_role("rowheader", name="bench-3")).to_be_visible()
                assert violations(page) == [] and overhang(page) <= 0
        with opened(browser, f"{page_file.as_uri()}#/device/{quote(HOSTILE, safe='')}") as page:
            expect(page.get_by_role("heading", level=1)).to_have_text(f"Device {HOSTILE}")
            expect(page.locator("main img, main script")).to_have_count(0)


NIGHT = """\
planrunner_suite: 1
title: Night <b>x</b>
benches: {a: {bench: virtual}}
plans: {drift: {plan: PLAN, matrix: {device_serial: ["A1", "A2"], operator: [night]}}}
"""


@pytest.mark.slow
def test_the_wall_shows_the_tests_of_the_night(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_bytes(SHIPPED.read_bytes())
    (tmp_path / "night.yaml").write_text(NIGHT.replace("PLAN", "plan.yaml"), encoding="utf-8")
    night = planrunner("night", "night.yaml", "--new", "--quiet", "--runs", "runs", cwd=tmp_path)
    assert night.returncode in (0, 1), night.stderr
    assert planrunner("site", "runs", "site", "--index", "index.sqlite", "--quiet", cwd=tmp_path).returncode == 0
    found = data_of(tmp_path / "site")
    (shown,) = found["entry"]["nights"]
    assert {test[5] for test in shown["tests"]} == {row[0] for row in found["runs-0"]}
    with chromium() as browser, opened(browser, (tmp_path / "site" / "index.html").as_uri()) as page:
        wall = page.get_by_role("table", name="Tests of the night, those that need attention first")
        expect(wall.locator("tbody tr")).to_have_count(2)
        expect(page.get_by_text("Night <b>x</b>: ")).to_be_visible()
        assert violations(page) == [] and overhang(page) <= 0
        wall.get_by_role("link", name=shown["tests"][0][5]).click()
        expect(page.get_by_text("1 run; 1 to 1 are shown")).to_be_visible()
