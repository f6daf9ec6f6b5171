"""The diagnosis after a night: an archive of simulated nights in which one bench tilts, and one in which nothing changes."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path

import pytest

from planrunner.archive import run_folder
from planrunner.base.documents import JsonObject
from planrunner.cli import main
from planrunner.night.history.databases import INDEX
from planrunner.night.suite import NightDiagnosis
from planrunner.tasks.diagnose_night import diagnose_night
from tests.night.history.made_runs import MadeRun, make_run

ROOT = Path(__file__).resolve().parents[2]
BENCH = (ROOT / "plans" / "benches" / "virtual_imu_nominal.yaml").read_text(encoding="utf-8")
PLAN = """\
planrunner: 1
title: Six positions
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
record: {device_serial: optional, item_identification: optional}
defaults: {settle: 2 s, dwell: 10 s}
segments:
  - for_each:
      orientation:
        A: {x: up, y: north, z: west}
        B: {x: down, y: north, z: east}
        C: {x: north, y: up, z: east}
        D: {x: north, y: down, z: west}
        E: {x: north, y: west, z: up}
        F: {x: north, y: east, z: down}
"""
NOW = datetime.now(UTC)
TILT, SINCE, NIGHTS = 40.0, 2, 5
"""Arc seconds about east; the first night of the tilt; number of nights."""


def night_of(number: int) -> datetime:
    return NOW - timedelta(days=NIGHTS - number)


def archive_of(folder: Path, monkeypatch: pytest.MonkeyPatch, tilt: float) -> Path:
    """Devices 17 and 18 on bench-2 and device 19, which has an identification instead of a serial number, on bench-1, once in each
    night."""
    monkeypatch.setenv(INDEX, str(folder / "index.sqlite"))
    archive, plan = folder / "runs", folder / "six.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    for bench in ("bench-1", "bench-2"):
        (folder / f"{bench}.yaml").write_text(
            BENCH.replace("name: virtual_imu_nominal", f"name: {bench}"), encoding="utf-8"
        )
    seed = 0
    for night in range(NIGHTS):
        for minute, (device, bench) in enumerate((("17", "bench-2"), ("18", "bench-2"), ("19", "bench-1"))):
            seed += 1
            made = night_of(night) + timedelta(minutes=minute)

            class Clock(datetime):
                @classmethod
                def now(cls, tz: tzinfo | None = None, made: datetime = made) -> datetime:  # type: ignore[override]
                    return made

            monkeypatch.setattr(run_folder, "datetime", Clock)
            words = ["simulate", str(plan), "--bench", str(folder / f"{bench}.yaml"), "--seed", str(seed), "--quiet"]
            item = "item_identification" if device == "19" else "device_serial"
            words += ["--set", f"{item}={device}", "--runs", str(archive)]
            if bench == "bench-2" and night >= SINCE and tilt:
                words += ["--with", f"table_tilt=about_east:{tilt} arcsec"]
            assert main(words) == 0
    monkeypatch.undo()
    monkeypatch.setenv(INDEX, str(folder / "index.sqlite"))
    return archive


def diagnosed(archive: Path) -> JsonObject:
    last = f"{night_of(NIGHTS - 1):%Y%m%d}"
    runs = [path.name for path in archive.glob(f"{last}*")]
    ((found, remark),) = diagnose_night(archive, runs, NightDiagnosis())
    assert found is not None and not remark
    schema = json.loads((ROOT / "schemas" / "night.schema.json").read_bytes())
    from jsonschema import Draft202012Validator

    Draft202012Validator(schema["properties"]["fleet"]["items"]).validate(found)
    assert found["runs"] == 3 * NIGHTS and {one["run"] for one in found["verdicts"]} == set(runs)
    return found


@pytest.mark.slow
def test_a_bench_that_tilts_is_named_with_size_and_night(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnosed(archive_of(tmp_path, monkeypatch, TILT))
    (change,) = found["changes"]
    assert (change["effect"], change["name"], change["kind"]) == ("table_tilt", "about_east", "step")
    assert change["sources"] == [["bench", "bench-2"]]
    assert abs(change["size"] - TILT) < 1.3 * change["expanded_uncertainty"] < 10
    after, until = (datetime.fromisoformat(change[key]) for key in ("after", "until"))
    assert after < night_of(SINCE) <= until <= night_of(SINCE) + timedelta(minutes=5)
    assert night_of(SINCE - 1) <= after
    assert any(text.startswith("bench bench-2: table_tilt about_east changed by ") for text in found["statements"])


@pytest.mark.slow
def test_an_archive_in_which_nothing_changes_says_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnosed(archive_of(tmp_path, monkeypatch, 0.0))
    assert found["changes"] == [] and found["shared"] == [] and found["statements"] == []


def test_a_damaged_run_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(INDEX, str(tmp_path / "index.sqlite"))
    archive = tmp_path / "runs"
    archive.mkdir()
    plan = make_run(archive, MadeRun()) / "plan.yaml"
    assert list(diagnose_night(archive, (), NightDiagnosis())) == []
    plan.write_bytes(plan.read_bytes() + b"#")
    ((found, remark),) = diagnose_night(archive, (), NightDiagnosis())
    assert found is None and remark.endswith("damaged runs are left out: 0000-calibration")
