"""Whole fleets: runs on simulated benches with known errors, diagnosed together."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_reader import RunReader
from planrunner.base.findings import InputError, Mark
from planrunner.base.workers import ALONE
from planrunner.cli import main
from planrunner.gap.fleet.amplitudes import AmplitudeEstimate, AmplitudeKey
from planrunner.gap.fleet.attribution import Source
from planrunner.reporting.fleet_page import sentences
from planrunner.tasks.diagnose_fleet import (
    FleetDiagnosis,
    RunOrigin,
    RunVerdict,
    _attributed,
    _shared,
    diagnose_fleet,
)
from tests.conftest import ROOT
from tests.tasks.test_simulate import PLAN

BENCH = ROOT / "plans" / "benches" / "virtual_imu_nominal.yaml"
BIASES = (0.004, -0.003, 0.001, -0.005)
"""Added to the bias of gyro x at each switch-on, deg/s."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Devices 17 and 18 on two benches: bench 2 is tilted by 60 arcsec about east, the gyros of device 17 are off by 210 ppm, and gyro x
    has another bias at each switch-on. The first run does not record its device, and the third one records it as an identification."""
    folder = tmp_path_factory.mktemp("fleet")
    plan = folder / "six.yaml"
    made = []
    for number, bias in enumerate(BIASES):
        bench, device = 1 + number // 2, 17 + number % 2
        record = "record: {device_serial: optional, item_identification: optional}"
        plan.write_text(PLAN.replace("bench:", f"{record}\nbench:", 1), encoding="utf-8")
        place = folder / f"bench-{bench}.yaml"
        text = BENCH.read_text(encoding="utf-8")
        place.write_text(text.replace("name: virtual_imu_nominal", f"name: bench-{bench}"), encoding="utf-8")
        effects = [f"gyro_bias=bias_x:{bias} deg/s"]
        effects += ["table_tilt=about_east:60 arcsec"] if bench == 2 else []
        effects += ["gyro_scale_factor=210 ppm"] if device == 17 else []
        words = [word for effect in effects for word in ("--with", effect)]
        item = "item_identification" if number == 2 else "device_serial"
        words += ["--set", f"{item}={device}"] if number else []
        where = folder / f"runs-{number}"
        main(
            [
                "simulate",
                str(plan),
                "--bench",
                str(place),
                *words,
                "--seed",
                str(number + 1),
                "--quiet",
                "--runs",
                str(where),
            ]
        )
        made += list(where.iterdir())
    return made


def _table(runs: list[Path], folder: Path, row: str = "{run},17,,") -> Path:
    table = folder / "origins.csv"
    table.write_text("run,device,bench,occasion\n" + row.format(run=runs[0].name) + "\n", encoding="utf-8")
    return table


@pytest.mark.slow
def test_bench_device_and_occasion_are_told_as_they_were_simulated(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = _table(runs, tmp_path)
    page = tmp_path / "fleet.html"
    capsys.readouterr()
    assert (
        main(["diagnose", *map(str, runs), "--origins", str(table), "--jobs", "2", "--json", "--html", str(page)]) == 0
    )
    found = json.loads(capsys.readouterr().out)
    schema = json.loads((ROOT / "schemas" / "fleet.schema.json").read_text(encoding="utf-8"))
    Draft202012Validator(schema).validate(found)
    assert [run["device"] for run in found["runs"]] == ["17", "18", "17", "18"]
    assert [run["bench"] for run in found["runs"]] == ["bench-1", "bench-1", "bench-2", "bench-2"]
    assert found["effects"] == ["table_tilt"]
    by_name = {(one["effect"], one["name"]): one for one in found["amplitudes"]}

    def part(key: tuple[str, str], source: str, label: str) -> dict:
        one = next(one for one in by_name[key]["contributions"] if one["sources"] == [source])
        return next(item for item in one["parts"] if item["label"] == label)

    assert ["bench"] in by_name["table_tilt", "about_east"]["named"]
    tilt = part(("table_tilt", "about_east"), "bench", "bench-2")["level"]
    assert abs(tilt["value"] - 60) < 1.5 * tilt["expanded_uncertainty"] < 5
    assert ["device"] in by_name["gyro_scale_factor", "k_y"]["named"]
    scale = part(("gyro_scale_factor", "k_y"), "device", "17")["difference"]
    assert abs(scale["value"] - 210) < 1.5 * scale["expanded_uncertainty"] < 60
    assert ["occasion"] in by_name["gyro_bias", "bias_x"]["named"]
    assert ["occasion"] not in by_name["accel_bias", "bias_x"]["named"]
    assert "Attributed effects and changes" in page.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("", "run.json does not say which device was measured"),
        ("other,17,,", "origins.csv:2:1: error[fleet-origins]: 'other' is not one of the runs given"),
        ("{run},17,,\n{run},18,,", "origins.csv:3:1: error[fleet-origins]"),
    ],
)
def test_what_is_missing_or_wrong_in_the_origins_is_refused(
    runs: list[Path], tmp_path: Path, row: str, said: str
) -> None:
    with pytest.raises(InputError) as caught:
        diagnose_fleet(runs, origins=_table(runs, tmp_path, row))
    assert said in str(caught.value)


@pytest.mark.slow
def test_a_run_with_another_kind_of_sensor_is_refused(runs: list[Path], tmp_path: Path) -> None:
    """Its error model may not be the same."""
    plan = tmp_path / "other.yaml"
    text = PLAN.replace("bench: virtual_imu_nominal", "bench: other-bench.yaml").replace(
        "kind: imu", "kind: navigation-unit"
    )
    plan.write_text(text, encoding="utf-8")
    bench = BENCH.read_text(encoding="utf-8").replace("kind: imu", "kind: navigation-unit")
    (tmp_path / "other-bench.yaml").write_text(bench, encoding="utf-8")
    assert main(["simulate", str(plan), "--quiet", "--runs", str(tmp_path / "runs")]) == 0
    other = next((tmp_path / "runs").iterdir())
    table = tmp_path / "origins.csv"
    table.write_text(f"run,device\n{other.name},19\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        diagnose_fleet([runs[1], other], origins=table, workers=ALONE)
    assert "fleet-other-sensor" in str(caught.value)


@pytest.mark.slow
def test_runs_that_cannot_be_read_are_left_out_with_skip(
    runs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The samples of the first run were changed, and its plan was replaced in a second copy; the third copy is no run folder, in the fourth
    a file is a link, and the check of the fifth refuses its plan."""
    from planrunner.tasks import estimate

    samples, plan, empty, link, refused = (tmp_path / name for name in ("samples", "plan", "empty", "link", "refused"))
    for copy in (samples, plan, link, refused):
        shutil.copytree(runs[1], copy)
    data = max((file for file in samples.rglob("*") if file.is_file()), key=lambda file: file.stat().st_size)
    raw = bytearray(data.read_bytes())
    raw[len(raw) // 2] ^= 1
    data.write_bytes(raw)
    (plan / "plan.yaml").write_text(PLAN, encoding="utf-8")
    empty.mkdir()
    (link / "plan.yaml").rename(tmp_path / "elsewhere.yaml")
    (link / "plan.yaml").symlink_to(tmp_path / "elsewhere.yaml")
    sound_run = estimate.sound_run

    def checked(reader: RunReader, *words: Any) -> Any:
        if reader.path.name == "refused":
            raise InputError.at(Mark("plan.yaml"), "plan-refused", "it no longer passes")
        return sound_run(reader, *words)

    monkeypatch.setattr(estimate, "sound_run", checked)
    bad = [samples, plan, empty, link, refused]
    found = diagnose_fleet([*bad, *runs[1:3]], workers=ALONE, skip=True)
    assert [one.run for one in found.origins] == runs[1:3]
    left = {one.mark.file for one in found.findings if "this run is left out" in one.message}
    assert {Path(name).name for name in left} >= {"samples", "plan", "empty", "link"} and len(left) == len(bad)
    with pytest.raises(IntegrityError):
        diagnose_fleet([samples, *runs[1:3]], workers=ALONE)
    with pytest.raises(InputError, match="it no longer passes"):
        diagnose_fleet([refused, *runs[1:3]], workers=ALONE)


# -- steps -------------------------------------------------------------------------------------------------------------

KEY = AmplitudeKey("table_tilt", "about_east", "arcsec")


def made(rows: list[tuple[str, str, float]], lots: dict[str, str] | None = None) -> FleetDiagnosis:
    """Estimates with s = 0.3 of runs (device, bench, true value), one in every half hour."""
    random = np.random.default_rng(1)
    origins = tuple(
        RunOrigin(
            Path(f"r{n}"),
            {Source.DEVICE: device, Source.BENCH: bench, Source.OCCASION: f"r{n}"},
            (datetime(2026, 3, 3, tzinfo=UTC) + n * timedelta(minutes=30)).isoformat(),
            (lots or {}).get(device, ""),
        )
        for n, (device, bench, _) in enumerate(rows)
    )
    fits = [[AmplitudeEstimate(KEY, value + random.normal(0, 0.3), 0.3)] for _, _, value in rows]
    attributed = _attributed(fits, origins, ALONE)
    verdict = RunVerdict("Plan", "imu", (), "effect", ("table_tilt",), (), {}, {}, "simulated")
    return FleetDiagnosis(
        origins, (verdict,) * len(rows), ("table_tilt",), attributed, {}, _shared(attributed, origins)
    )


def test_two_steps_of_a_device_on_one_day_make_three_parts() -> None:
    """The later step is the larger one, and is found first. Device B stays at 0."""
    a = [0.0] * 5 + [2.0] * 6 + [12.0] * 6
    found = made([row for value in a for row in (("A", "b", value), ("B", "b", 0.0))])
    (one,) = found.attributed
    assert [change.before for change in one.changes] == [11, 5]
    parts = {(part.label, part.since[11:16]): part for part in one.attribution.of(Source.DEVICE).parts}
    assert {key: part.runs for key, part in parts.items()} == {
        ("A", ""): 5,
        ("A", "05:00"): 6,
        ("A", "11:00"): 6,
        ("B", ""): 17,
    }
    for key, true in {("A", ""): 0.0, ("A", "05:00"): 2.0, ("A", "11:00"): 12.0}.items():
        level = parts[key].level
        assert level is not None and abs(level.value - true) < 1.5 * level.expanded < 0.6
    assert one.attribution.of(Source.OCCASION).probability < 0.5
    assert any(
        text.startswith("device A since 2026-03-03 11:00 UTC: table_tilt") for text in sentences(found.to_json())
    )


def test_a_bench_that_stepped_keeps_its_name_and_its_devices() -> None:
    rows = [
        (device, bench, 60.0 * (bench == "v" and night > 2)) for night in range(6) for bench in "uv" for device in "AB"
    ]
    found = made(rows).to_json()
    schema = json.loads((ROOT / "schemas" / "fleet.schema.json").read_text(encoding="utf-8"))
    Draft202012Validator(schema).validate(found)
    said = next(
        text for text in sentences(found) if " since " in text and text.startswith("bench v since 2026-03-03 07:00")
    )
    assert "(6 runs, 2 devices, P > 0.9" in said


def test_devices_that_stepped_are_those_of_their_lot() -> None:
    """Those of lot 17 are at 5, and at 11 from another night on each; the three others are at 0."""
    since = {"A": 4, "B": 8, "C": 12}
    rows = [
        (device, "b", (5.0 + 6.0 * (night >= since[device])) if device in since else 0.0)
        for night in range(16)
        for device in "ABCDEF"
    ]
    (shared,) = made(rows, dict.fromkeys("ABC", "17")).shared
    assert shared.devices == ("A", "B", "C") and shared.others == 3 and shared.chance == pytest.approx(1 / 20)
    assert abs(shared.difference - 8.0) < 1.5 * shared.expanded < 1.0
