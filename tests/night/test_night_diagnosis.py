"""The diagnosis after a night: an archive of simulated nights in which one bench tilts, and one in which nothing changes."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path

import pytest

from planrunner.archive import run_folder
from planrunner.base.documents import JsonObject
from planrunner.base.workers import ALONE
from planrunner.cli import main
from planrunner.night.history.databases import INDEX
from planrunner.night.suite import NightDiagnosis
from planrunner.tasks import diagnose_fleet, kept_diagnoses
from planrunner.tasks.diagnose_night import diagnose_night
from planrunner.tasks.kept_diagnoses import FOLDER as KEPT
from planrunner.tasks.kept_diagnoses import KeptDiagnoses, key_of
from tests.night.history.made_runs import MadeRun, make_run

ROOT = Path(__file__).resolve().parents[2]
BENCH = (ROOT / "plans" / "benches" / "virtual_imu_nominal.yaml").read_text(encoding="utf-8")
PLAN = """\
planrunner: 1
title: Six positions
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
record: {device_serial: optional, item_identification: optional}
defaults: {settle: 2 s, dwell: 2 min}
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
NIGHT = """\
planrunner_suite: 1
title: Night
benches: {one: {bench: ./bench-1.yaml}, two: {bench: ./tilted.yaml}}
devices:
  "17": {benches: two, set: {device_serial: "17"}, seed: 101}
  "18": {benches: two, set: {device_serial: "18"}, seed: 102}
  "19": {benches: one, set: {item_identification: "19"}, seed: 103}
plans: {six: {plan: six.yaml, devices: ["17", "18", "19"]}}
diagnosis: {}
"""
NOW = datetime.now(UTC)
TILT, SINCE, NIGHTS = 4.0, 2, 5
"""Arc seconds about east; the first night of the tilt; number of nights."""


def night_of(number: int) -> datetime:
    return NOW - timedelta(days=NIGHTS - number)


def archive_of(folder: Path, monkeypatch: pytest.MonkeyPatch, tilt: float, nights: int = NIGHTS) -> Path:
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
    for night in range(nights):
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
                words += ["--write-bench", str(folder / "tilted.yaml")]
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
    """The last night is one of `planrunner night`. Its diagnosis finds the tilt of 4 arcsec that began two nights before.
    Its summary and the site say so."""
    archive = archive_of(tmp_path, monkeypatch, TILT, NIGHTS - 1)
    monkeypatch.setenv(KEPT, str(tmp_path / "kept"))
    monkeypatch.chdir(tmp_path)
    Path("night.yaml").write_text(NIGHT, encoding="utf-8")
    assert main(["night", "night.yaml", "--flushed", "--quiet", "--runs", str(archive)]) == 0
    (folder,) = (archive / "nights").glob("2*")
    record = json.loads((folder / "night.json").read_bytes())
    (found,) = record["fleet"]
    assert found["runs"] == 3 * NIGHTS and record["remarks"] == []
    (change,) = found["changes"]
    assert (change["effect"], change["name"], change["kind"]) == ("table_tilt", "about_east", "step")
    assert change["sources"] == [["bench", "bench-2"]]
    assert abs(change["size"] - TILT) < 1.3 * change["expanded_uncertainty"] < 2
    after, until = (datetime.fromisoformat(change[key]) for key in ("after", "until"))
    assert after < night_of(SINCE) <= until <= night_of(SINCE) + timedelta(minutes=5)
    assert night_of(SINCE - 1) <= after
    (said,) = [
        text for text in found["statements"] if text.startswith("bench bench-2: table_tilt about_east changed by ")
    ]
    assert said.replace("<", "&lt;") in (folder / "summary.md").read_text("utf-8")
    assert main(["site", str(archive), "site", "--quiet"]) == 0
    assert json.dumps(said) in Path("site/data.js").read_text("ascii")  # the wall


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


LOT_17 = (1, 4, 6)
"""The devices D1, D4 and D6 of eight. Their gyro about x has a temperature coefficient of 7 deg/(h·K), those of lot 16 have none."""
WARM = """\
planrunner: 1
title: Six positions, cold and warm
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
record: {device_serial: optional, lot: optional, turn: optional}
defaults: {settle: 2 s, dwell: 10 s, soak: 20 min}
segments:
  - for_each:
      temperature: {cold: 5 degC, warm: 45 degC, again: 5 degC}
      orientation:
        A: {x: up, y: north, z: west}
        B: {x: down, y: north, z: east}
        C: {x: north, y: up, z: east}
        D: {x: north, y: down, z: west}
        E: {x: north, y: west, z: up}
        F: {x: north, y: east, z: down}
"""


@pytest.mark.slow
def test_a_night_says_what_three_devices_of_a_lot_share_and_computes_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A suite of simulated benches, whose sensors have formulas of their own: two runs of each of eight devices, and one that names no
    device. The summary, the site and the record say the same; asked again, nothing is diagnosed anew."""
    monkeypatch.setenv(INDEX, str(tmp_path / "index.sqlite"))
    monkeypatch.setenv(KEPT, str(tmp_path / "kept"))
    monkeypatch.chdir(tmp_path)
    Path("warm.yaml").write_text(WARM, encoding="utf-8")
    benches, devices = [], []
    for number in range(8):
        lot, error = (17, 'bias_temperature: ["7 deg/h/K"], ') if number in LOT_17 else (16, "")
        text = BENCH.replace("x: {bias: 0.12 deg/s, ", f"x: {{bias: 0.12 deg/s, {error}")
        text = text.replace("name: virtual_imu_nominal", f"name: bench-{1 + number // 4}")
        assert (error in text) and f"bench-{1 + number // 4}" in text
        Path(f"b{number}.yaml").write_text(text, encoding="utf-8")
        benches.append(f"  b{number}: {{bench: ./b{number}.yaml}}\n")
        information = f"set: {{device_serial: D{number}, lot: L{lot}}}, seed: {number}"
        devices.append(f"  D{number}: {{benches: b{number}, {information}}}\n")
    suite = (
        "planrunner_suite: 1\ntitle: Night\ndiagnosis: {recent: 40}\n"
        f"benches:\n{''.join(benches)}devices:\n{''.join(devices)}  stranger: {{benches: b0}}\n"
        f"plans:\n  warm: {{plan: warm.yaml, devices: [{', '.join(f'D{k}' for k in range(8))}], "
        'matrix: {turn: ["1", "2"]}}\n  unnamed: {plan: warm.yaml, devices: stranger}\n'
    )
    Path("night.yaml").write_text(suite, encoding="utf-8")
    assert main(["night", "night.yaml", "--flushed", "--quiet", "--runs", "runs"]) == 0
    (night,) = Path("runs/nights").glob("2*")
    record = json.loads((night / "night.json").read_bytes())
    (stranger,) = [test["run"] for test in record["tests"] if test["device"] == "stranger"]
    assert record["remarks"] == [
        f"diagnosis of the night: runs that name no device (device_serial or item_identification) are left out: {stranger}"
    ]
    (fleet,) = record["fleet"]
    named = {one["run"]: one["effects"] for one in fleet["verdicts"]}
    runs = {test["run"]: test["device"] for test in record["tests"] if test["run"] in named}
    assert len(runs) == 16
    assert all(
        named[run] == (["gyro_bias_temperature"] if int(device[1:]) in LOT_17 else []) for run, device in runs.items()
    )
    (shared,) = [one for one in fleet["shared"] if one["lot"] == "L17"]
    assert (shared["effect"], shared["name"], shared["unit"]) == ("gyro_bias_temperature", "c1_x", "deg/s/K")
    assert set(shared["devices"]) == {"D1", "D4", "D6"} and shared["others"] == 5
    assert shared["difference"] == pytest.approx(7 / 3600, abs=shared["expanded_uncertainty"])
    assert shared["chance"] == pytest.approx(1 / 56, rel=0.01)  # of the ways to draw three of eight
    (said,) = [text for text in fleet["statements"] if text.startswith("3 devices of lot L17 ")]
    assert main(["site", "runs", "site", "--quiet"]) == 0
    assert said in (night / "summary.md").read_text("utf-8")
    assert json.dumps(said) in Path("site/data.js").read_text("ascii")  # the wall

    def never(*_: object) -> None:
        raise AssertionError("this run was diagnosed before")

    monkeypatch.setattr(diagnose_fleet, "_verdict", never)
    monkeypatch.setattr(diagnose_fleet, "_fitted", never)
    ((again, _),) = diagnose_night(Path("runs"), list(runs), NightDiagnosis(), ALONE)
    assert again == fleet


def test_what_is_kept_of_a_diagnosis_depends_on_the_run_the_question_and_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = key_of("verdict", "0" * 64, ["bias"])
    others = [
        key_of("amplitudes", "0" * 64, ["bias"]),
        key_of("verdict", "1" * 64, ["bias"]),
        key_of("verdict", "0" * 64, []),
    ]
    monkeypatch.setattr(kept_diagnoses, "_program", lambda: {"planrunner": "another"})
    others.append(key_of("verdict", "0" * 64, ["bias"]))
    assert len({key, *others}) == 5
    monkeypatch.setenv(KEPT, str(tmp_path / "kept"))
    kept = KeptDiagnoses.of_user()
    kept.put(key, {"x": [1.5, None]})
    assert kept.get(key) == {"x": [1.5, None]} and kept.get(others[0]) is None
    (tmp_path / "kept" / key).write_bytes(b"{")  # cut by a power failure: it counts as missing
    assert KeptDiagnoses.of_user().get(key) is None
    (tmp_path / "kept").chmod(0o777)
    assert KeptDiagnoses.of_user().folder is None  # somebody else could have put results there


def test_only_old_results_are_removed_from_the_folder_that_keeps_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The environment may name a folder with other files."""
    monkeypatch.setenv(KEPT, str(tmp_path))
    key = key_of("verdict", "0" * 64, [])
    for name in (key, "thesis.txt"):
        (tmp_path / name).write_bytes(b"{}")
        os.utime(tmp_path / name, (0, 0))
    assert KeptDiagnoses.of_user().get(key) is None
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.txt"]
