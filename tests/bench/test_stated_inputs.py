"""What a bench states of uncertainty, where it says so, and whether its calibrations hold on the day."""

from __future__ import annotations

import math
from datetime import date
from pathlib import Path

import pytest

from planrunner.base.findings import Findings
from planrunner.bench.calibration import check_validity
from planrunner.bench.model import models, parse_bench
from planrunner.plan import source
from planrunner.plan.model import MountedAxis
from planrunner.plan.quantity import parse_quantity
from planrunner.tasks.check import check_plan
from planrunner.uncertainty.influences import InputQuantity, Inputs
from planrunner.uncertainty.stated_inputs import stated_inputs

ARCSEC = math.pi / 648000
BENCH = """planrunner_bench: 1
name: lab
clock: virtual
site:
  latitude: 39.98 deg ± 1 arcsec
  latitude_kind: astronomic
  gravity: {value: 9.80154 m/s^2, half_width: 3e-5 m/s^2, distribution: rectangular}
  azimuth: {value: 0 deg, standard_uncertainty: 10 arcsec, degrees_of_freedom: 9}
  survey: {certificate: survey 7, date: 2026-02-10, laboratory: surveyors}
fixture: {asset: FX-7, calibration: {certificate: FX-7 / 31, date: 2026-02-20}}
instruments:
  table:
    driver: virtual_table
    asset: RT-0042
    calibration: {certificate: RT-0042 / 117, date: 2026-03-01, due: 2027-03-01}
    axes:
      - {name: outer, direction: up, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}
      - {name: middle, direction: east, max_rate: 200 deg/s, max_acceleration: 100 deg/s^2}
      - {name: inner, direction: north, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}
    position_uncertainty: 3 arcsec
    orthogonality: 5 arcsec
    rate_stability: 10 ppm
  chamber:
    driver: virtual_chamber
    lowest: -55 degC
    highest: 85 degC
    ramp: 3 K/min
    tolerance: 0.3 K
    temperature_uncertainty: 0.1 K
  gyro:
    driver: virtual_flexure_gyro
    scale_factor: {x: 0.2 (deg/h)/(pulse/s), y: 0.2 (deg/h)/(pulse/s)}
    drift_x: {F: 1 deg/h, X: 1 deg/h/g, Y: 1 deg/h/g, Z: 1 deg/h/g}
    drift_y: {F: 1 deg/h, X: 1 deg/h/g, Y: 1 deg/h/g, Z: 1 deg/h/g}
    white_noise: 0.9 pulse/sqrt(s)
    resolution: 1 pulse/s
    full_scale: 1000000 pulse/s
    sample_rate: 100 Hz
"""
PLAN = """planrunner: 1
title: one position
bench: bench.yaml
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
segments:
  - {label: P1, orientation: {x: up, y: north, z: west}, dwell: DWELL}
"""


def inputs(text: str = BENCH, **mounting: MountedAxis) -> Inputs:
    bench, log = parse_bench(source.parse(text, "bench.yaml"))
    assert bench is not None
    assert not log.errors
    return stated_inputs(bench, models(bench), mounting)


def stated(name: str, found: Inputs | None = None) -> InputQuantity:
    quantity = (found or inputs()).get(name)
    assert quantity is not None
    return quantity


def test_every_stated_uncertainty_is_an_input_with_its_source() -> None:
    """Half-widths divided by √3, 3 arcsec in rad, and √(0.3²/3 + 0.1²) K of the chamber's air."""
    found = inputs(
        x=MountedAxis(angle=parse_quantity("54.7356 deg ± 20 arcsec"), azimuth=parse_quantity("0 deg ± 1 arcmin"))
    )
    widths = {name: quantity.standard_uncertainty for name, quantity in found.quantities.items()}
    assert widths == pytest.approx(
        {
            "latitude": ARCSEC,
            "gravity": 3e-5 / math.sqrt(3),
            "azimuth": 10 * ARCSEC,
            "fixture angle x": 20 * ARCSEC,
            "fixture azimuth x": 60 * ARCSEC,
            "table position": 3 * ARCSEC,
            "table orthogonality": 5 * ARCSEC,
            "table rate": 1e-5,
            "temperature": 0.2,
            "resolution torquer_x": 1 / math.sqrt(12),
            "resolution torquer_y": 1 / math.sqrt(12),
        },
        rel=1e-9,
    )
    shapes = {
        name: quantity.distribution for name, quantity in found.quantities.items() if quantity.distribution != "normal"
    }
    assert shapes == {"gravity": "rectangular", "azimuth": "t"} | dict.fromkeys(
        ("resolution torquer_x", "resolution torquer_y"), "rectangular"
    )
    assert stated("azimuth", found).degrees_of_freedom == 9
    sources = {
        name: (stated(name, found).source, stated(name, found).calibrated) for name in ("latitude", "table rate")
    }
    assert sources == {
        "latitude": ("bench site, survey 7 (surveyors)", "2026-02-10"),
        "table rate": ("bench 'table', asset RT-0042, RT-0042 / 117", "2026-03-01"),
    }
    assert stated("fixture angle x", found).source == "plan mounting.x, asset FX-7, FX-7 / 31"
    assert stated("table position", found).shown == "arcsec"
    assert stated("latitude", found).value / stated("latitude", found).shown_factor == pytest.approx(39.98)


def test_what_nobody_states_is_no_input() -> None:
    bare = (
        BENCH.replace(" ± 1 arcsec", "")
        .replace("    position_uncertainty: 3 arcsec\n", "")
        .replace("    resolution: 1 pulse/s\n", "")
    )
    assert not {"latitude", "table position", "resolution torquer_x"} & set(inputs(bare).quantities)


def findings(folder: Path, today: str, dwell: str = "2 min", bench: str = BENCH) -> list[tuple[str, str, int, str]]:
    (folder / "bench.yaml").write_text(bench, encoding="utf-8")
    (folder / "plan.yaml").write_text(PLAN.replace("DWELL", dwell), encoding="utf-8")
    checked = check_plan(folder / "plan.yaml", today=date.fromisoformat(today))
    return [(item.code, item.severity, item.mark.line, item.message) for item in checked.findings]


def test_an_expired_calibration_stops_a_run_and_a_short_one_is_announced(tmp_path: Path) -> None:
    due = next(n for n, line in enumerate(BENCH.splitlines(), start=1) if "2027-03-01" in line)
    assert findings(tmp_path, "2027-01-15") == []
    assert findings(tmp_path, "2027-03-01")[0][:3] == ("bench-calibration-due", "warning", due)
    code, severity, line, message = findings(tmp_path, "2027-03-02")[0]
    assert (code, severity, line) == ("bench-calibration-expired", "error", due)
    assert message == "the calibration of 'table' (RT-0042 / 117) expired on 2027-03-01; it is 2027-03-02"
    assert "expires during this run" in findings(tmp_path, "2027-01-15", "1500 h")[0][3]
    assert findings(tmp_path, "2026-02-25")[0][:2] == ("bench-calibration-future", "error")


def test_at_the_end_of_the_calendar_a_calibration_is_judged_as_ever() -> None:
    """A run may last beyond the last day that the calendar has."""

    def judged(due: str, days: float) -> list[str]:
        bench, _ = parse_bench(source.parse(BENCH.replace("due: 2027-03-01", f"due: {due}"), "bench.yaml"))
        assert bench is not None
        log = Findings()
        check_validity(bench.calibrations(), date(9998, 6, 1), days * 86400, log)
        return [item.message.split(") ")[1] for item in log]

    assert judged("9999-12-31", 500) == []
    assert judged("9999-12-31", 600) == ["expires during this run, on 9999-12-31"]
    assert judged("9999-12-31", 1e12) == ["expires during this run, on 9999-12-31"]
    assert judged("9998-06-20", 1) == ["expires soon, on 9998-06-20"]


@pytest.mark.parametrize(
    ("wrong", "message", "column"),
    [
        ("2026-02-30", "'2026-02-30' is not a calendar date", "date"),
        ("2028-03-01", "the due date of the calibration, 2027-03-01, is before its date, 2028-03-01", "due"),
    ],
)
def test_dates_that_cannot_be_are_errors_where_they_stand(wrong: str, message: str, column: str) -> None:
    text = BENCH.replace("date: 2026-03-01", f"date: {wrong}")
    _, log = parse_bench(source.parse(text, "bench.yaml"))
    (error,) = log.errors
    assert (error.code, error.message) == ("meaning-date", message)
    line = text.splitlines()[error.mark.line - 1]
    assert line[error.mark.column - 1 :].startswith({"date": wrong, "due": "2027-03-01"}[column])


def test_figures_that_no_certificate_stands_behind_are_noted_on_a_real_bench(tmp_path: Path) -> None:
    """The chamber of this bench has none; the simulated clock asks for none."""
    assert findings(tmp_path, "2027-01-15") == []
    real = BENCH.replace("clock: virtual", "clock: wall")
    ((code, severity, _, message),) = findings(tmp_path, "2027-01-15", bench=real)
    assert (code, severity) == ("bench-no-calibration", "note")
    assert message.startswith("'chamber' states uncertainties")
    without = real.replace("    temperature_uncertainty: 0.1 K\n", "")
    assert findings(tmp_path, "2027-01-15", bench=without) == []
