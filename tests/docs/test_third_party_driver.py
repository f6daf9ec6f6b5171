"""The documented third-party driver: shown whole in the docs, installed like any package, used from a bench file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from third_party import ROOT, Planrunner, installed, shown_whole

GIVEN = ("--set", "device_serial=1", "--set", "operator=test", "--quiet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    bench = bench.replace("safe_order: [table, chamber, gyro]", "safe_order: [table, chamber, gyro, room]")
    bench = bench.replace("instruments:\n", "instruments:\n  room: {driver: logged_thermometer, file: room.txt}\n")
    (folder / "mine.yaml").write_text(bench, encoding="utf-8")
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    (folder / "plan.yaml").write_text(plan, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def planrunner(folder: Path) -> Planrunner:
    return installed("logged_thermometer", folder)


def test_the_docs_show_the_code_that_is_tested() -> None:
    assert shown_whole("writing-a-driver.md", "logged_thermometer")
    assert shown_whole("writing-a-driver.md", "votsch_chamber")


@pytest.mark.slow
def test_its_readings_stand_in_every_segment(folder: Path, planrunner: Planrunner) -> None:
    (folder / "room.txt").write_text("21.5\n22.25\n", encoding="utf-8")
    run = planrunner("run", "plan.yaml", "--bench", "mine.yaml", *GIVEN, "--json")
    assert run.returncode == 0, run.stderr
    segments = json.loads(run.stdout)["segments"]
    assert len(segments) == 19
    assert {segment["readings"]["room.air_degC"] for segment in segments} == {22.25}


@pytest.mark.slow
def test_what_it_cannot_do_is_said_before_anything_moves(folder: Path, planrunner: Planrunner) -> None:
    (folder / "room.txt").write_text("", encoding="utf-8")
    before = set((folder / "runs").glob("*"))
    run = planrunner("run", "plan.yaml", "--bench", "mine.yaml", *GIVEN)
    assert run.returncode == 3
    assert "room (logged_thermometer) cannot be connected: no temperature in room.txt" in run.stderr
    assert set((folder / "runs").glob("*")) == before


@pytest.mark.slow
def test_its_keys_and_name_are_checked(folder: Path, planrunner: Planrunner) -> None:
    bench = (folder / "mine.yaml").read_text(encoding="utf-8")
    (folder / "key.yaml").write_text(bench.replace("file: room.txt", "fle: room.txt"), encoding="utf-8")
    (folder / "name.yaml").write_text(bench.replace("logged_thermometer", "logged_termometer"), encoding="utf-8")
    assert "did you mean 'file'?" in planrunner("check", "plan.yaml", "--bench", "key.yaml").stderr
    assert "did you mean 'logged_thermometer'?" in planrunner("check", "plan.yaml", "--bench", "name.yaml").stderr
    assert "monitor: A thermometer that another program reads and logs." in planrunner("bench", "list").stdout


@pytest.mark.slow
def test_the_documented_chamber_is_installed_checked_and_asked(tmp_path: Path) -> None:
    chamber = installed("votsch_chamber", tmp_path)
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    head = bench[: bench.index("instruments:")].replace("safe_order: [table, chamber, gyro]\n", "")
    own = (
        'instruments:\n  chamber: {driver: votsch, address: "%s", lowest: -40 degC, highest: 130 degC, ramp: 3 K/min}\n'
    )
    (tmp_path / "wrong.yaml").write_text(head + own % "192.168.0.6:2049", encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(head + own % "ASRL/dev/no-such-port::INSTR", encoding="utf-8")
    assert "chamber: A chamber with the ASCII-2 protocol, such as one of Vötsch." in chamber("bench", "list").stdout
    assert "'192.168.0.6:2049' is not a VISA resource name" in chamber("bench", "ping", "wrong.yaml").stderr
    asked = chamber("bench", "ping", "mine.yaml")
    assert asked.returncode == 3, asked.stderr
    assert "FAILED: ASRL/dev/no-such-port::INSTR, when asked '$01I', cannot be reached" in asked.stdout
