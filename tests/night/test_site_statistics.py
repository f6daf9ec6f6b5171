"""What a site shows of the statistics: control charts, changes with possible causes, fleet statements and check standards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import expect

from planrunner.archive import formats
from planrunner.night.history.control_charts import control_charts
from planrunner.night.history.index import Index
from planrunner.night.site import BuiltSite, build_site
from tests.browser import chromium, opened, overhang, violations
from tests.night.history.made_runs import MadeRun, make_run
from tests.night.test_site import data_of

ROOT = Path(__file__).resolve().parents[2]
SAID = "bench bench-2: table_tilt about_east changed by 4.1 ± 0.6 arcsec between 2026-03-02 23:10 and 2026-03-03 21:04 UTC."
SCATTER = np.random.default_rng(7).normal(0, 0.1, 30)
VALUES = [1 + SCATTER[k] + (0.6 if k >= 18 else 0.0) for k in range(30)]


def site_of(folder: Path) -> BuiltSite:
    """Thirty runs of CS-01 whose level jumps with the firmware of the table, and a night; the bench declares CS-01 as check standard."""
    archive = folder / "runs"
    archive.mkdir()
    for k, value in enumerate(VALUES):
        made = MadeRun(device="CS-01", bench="bench-2", days=k, values={"bias": (value, 0.1)}, plan="calibration")
        made = replace(made, operator=("ann", "bob")[k % 2], firmware="2.1" if k >= 18 else "2.0", limit=(-2.0, 2.0))
        run = make_run(archive, made, k)
    index = Index.open(archive, str(folder / "index.sqlite"))
    index.refresh()
    bench = (
        (ROOT / "plans" / "benches" / "virtual.yaml")
        .read_text(encoding="utf-8")
        .replace("name: virtual\n", "name: bench-2\n")
    )
    rule = "{device: CS-01, plan: calibration.yaml, coefficients: {drift.bias: {reference: 1.0 deg/h}}, max_age: 1 d}"
    (run / "bench.yaml").write_text(f"{bench}check_standard: {rule}\n", encoding="utf-8")
    night = archive / "nights" / "20240131T200000Z-night-000000"
    night.mkdir(parents=True)
    (night / "night.json").write_bytes(formats.to_bytes(a_night(run.name)))
    with index:
        return build_site(index, folder / "site")


def a_night(run: str) -> dict[str, Any]:
    at = "2024-01-31T20:00:00+01:00"
    test: dict[str, Any] = {
        "entry": "calibration", "plan": "calibration.yaml", "parameters": {}, "seconds": 60.0, "foreseen": None, "foreseen_obstacle": "",
        "begins": at, "ends": at, "analysis": None, "limits": [], "attempts": [], "bench": "a", "run": None,
    }  # fmt: skip
    state: dict[str, Any] = {
        "planrunner_check_standard": 1, "bench": "bench-2", "device": "CS-01", "standing": "out of control", "run": run, "created": at,
        "coefficients": [], "reasons": ["drift.bias is 1.6 deg/h, outside 1 ± 0.42"],
    }  # fmt: skip
    blocked = "it needs check standard/CS-01/a, which did not pass"
    return {
        "planrunner_night": 1, "night": "20240131T200000Z-night-000000", "suite": "night.yaml", "title": "Gyro laboratory",
        "digest": "0" * 64, "clock": "wall", "host": "lab", "planrunner": "1", "state": "finished", "begins": at, "limit": None,
        "foreseen_end": at, "ends": at, "exit_code": 3, "sessions": 1, "counts": {"failed": 1, "not_run": 1},
        "tests": [
            {**test, "test": "check standard/CS-01/a", "device": "CS-01", "state": "failed", "reason": state["reasons"][0], "run": run},
            {**test, "test": "work/D1/a", "device": "D1", "state": "not_run", "reason": blocked},
        ],
        "warm_ups": [], "remarks": [], "notifications": [], "check_standards": [{"bench": "a", "state": state}],
        "fleet": [{"plan": "Title of calibration", "runs": 30, "statements": [SAID], "changes": [], "shared": [], "verdicts": []}],
    }  # fmt: skip


def test_the_data_are_those_of_the_charts(tmp_path: Path) -> None:
    site_of(tmp_path)
    found = data_of(tmp_path / "site")
    (series,) = found["device-0"]
    charts = control_charts(VALUES, [0.1] * 30)
    assert charts is not None
    for name, chart in (("ewma", charts.ewma), ("cusum_up", charts.cusum_up), ("cusum_down", charts.cusum_down)):
        assert series[name]["value"] == pytest.approx(chart.statistic.tolist())
        assert series[name]["upper"] == pytest.approx(chart.upper.tolist())
    (change,) = series["changes"]
    assert (change["before"], change["after"]) == (17, 18)
    assert abs(change["step"] - 0.6) < 3 * change["u"]
    assert change["causes"][0] == ["firmware table", "2.0", "2.1", 1.0]
    (standard,) = found["entry"]["standards"]
    assert standard["standing"] == "out of control" and standard["bench"] == "bench-2"
    (night,) = found["entry"]["nights"]
    assert night["fleet"] == [{"plan": "Title of calibration", "runs": 30, "statements": [SAID]}]
    assert night["check_standards"][0][:3] == ["a", "CS-01", "out of control"]


@pytest.mark.slow
def test_the_pages_show_them(tmp_path: Path) -> None:
    expect.set_options(timeout=120_000)
    page_file = site_of(tmp_path).page
    with chromium() as browser:
        for scheme, width in (("light", 1280), ("dark", 390)):
            with opened(browser, page_file.as_uri(), "dark" if scheme == "dark" else "light", width) as page:
                expect(page.get_by_role("listitem").filter(has_text=SAID)).to_be_visible()
                expect(page.get_by_role("table", name="Check standards that were measured first")).to_be_visible()
                assert violations(page) == [] and overhang(page) <= 0
                page.get_by_role("link", name="Benches").click()
                row = page.get_by_role("table", name="Check standards of the benches").locator("tbody tr")
                expect(row).to_contain_text("out of control")
                assert violations(page) == [] and overhang(page) <= 0
                row.get_by_role("link", name="CS-01").click()
                expect(page.locator("canvas")).to_have_count(3)
                changes = page.get_by_role("table", name="Changes in level, and what else changed at the same time")
                expect(changes).to_contain_text("firmware table: 2.0 → 2.1, and so in all runs before and after")
                expect(page.get_by_text("Cumulative sums (CUSUM)")).to_contain_text("also the newest")
                expect(page.get_by_role("listitem").filter(has_text=SAID)).to_be_visible()
                assert violations(page) == [] and overhang(page) <= 0
