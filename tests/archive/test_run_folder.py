"""Run folders: what they hold, one writer at a time, sealed, changed afterwards, taken again; analyses beside them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from planrunner.archive import analyses as stored
from planrunner.archive import formats, space
from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Schedule, Segment
from tests.archive.analyses import add_analysis


def segment(index: int, **given: Any) -> Segment:
    return Segment(index, f"P{index + 1}", None, "unknown", Rest(), **{"dwell": 1.0, **given})


def analyses(run: Path) -> list[Path]:
    return [run / "analyses" / str(number) for number in stored.numbers(GuardedFolder.open(run))]


SCHEDULE = Schedule((segment(0), segment(1)), 2.0)


def write_segment(writer: RunWriter, item: Segment, rows: int = 100) -> None:
    writer.begin(item, float(item.index), {"x": "deg/s"})
    time = item.index + np.arange(rows) / rows
    writer.append(Block(time, {"x": np.sin(time)}), item.index + 1.0)
    writer.acknowledge(item.index + 1.0, {}, {"chamber.air_K": 298.0 + item.index, "chamber.door": float("nan")})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished, sealed run of two segments."""
    with RunWriter.create(
        tmp_path / "runs", "a plan/with: signs", b"plan\r\n", b"bench", {"serial": "0042"}, seed=3
    ) as writer:
        for item in SCHEDULE.segments:
            write_segment(writer, item)
        writer.finish()
    return writer.path


def test_what_an_auditor_opens(run: Path) -> None:
    assert re.fullmatch(r"\d{8}T\d{6}Z-a_plan_with_signs-[0-9a-f]{6}", run.name)
    names = {path.relative_to(run).as_posix() for path in run.rglob("*")} - {".lock", ".origin"}
    files = {"run.json", "plan.yaml", "bench.yaml", "journal.jsonl", "seal.json"}
    assert names == {*files, "segments", "segments/0001-P1.parquet", "segments/0002-P2.parquet"}
    assert (run / "plan.yaml").read_bytes() == b"plan\r\n"
    given = json.loads((run / "run.json").read_text())
    assert (given["planrunner_run"], given["seed"], given["info"]) == (1, 3, {"serial": "0042"})
    assert {"planrunner", "python", "numpy", "pyarrow"} <= set(given["versions"])


def test_reading_it(run: Path) -> None:
    reader = RunReader.open(run)
    first, second = reader.recording(SCHEDULE)
    assert reader.sealed
    assert first.statistics.mean[0] == pytest.approx(np.sin(np.arange(100) / 100).mean(), rel=1e-14)
    assert second.readings["chamber.air_K"] == 299.0
    assert np.isnan(second.readings["chamber.door"])
    assert reader.check_digests() == 5
    assert reader.plan_bytes == b"plan\r\n"


@pytest.mark.parametrize(("planned", "reads"), [("+P1", True), ("P+1", True), ("-P1", False), ("P11", False)])
def test_labels_that_older_sweeps_spelt_with_other_signs(run: Path, planned: str, reads: bool) -> None:
    """A run of a version that wrote `R10` for `R+10`, or `+20degC` for `20degC`, is read as before."""
    schedule = Schedule((replace(segment(0), label=planned), segment(1)), 2.0)
    if reads:
        assert [item.label for item in RunReader.open(run).recording(schedule)] == [planned, "P2"]
    else:
        with pytest.raises(IntegrityError, match="but the plan has no such segment at this place"):
            RunReader.open(run).recording(schedule)


def test_shipped_schemas_are_schemas() -> None:
    for name in ("run", "journal-event", "seal", "digests", "issued"):
        Draft202012Validator.check_schema(formats.schema(name))


# -- changed afterwards ----------------------------------------------------------------------------------------------------


def flip(path: Path, place: int = -20) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


CHANGES: dict[str, Callable[[Path], object]] = {
    "plan": lambda run: flip(run / "plan.yaml", 0),
    "bench": lambda run: (run / "bench.yaml").unlink(),
    "run.json": lambda run: flip(run / "run.json", -5),
    "run.json is not JSON": lambda run: (run / "run.json").write_text("{"),
    "run.json without a key": lambda run: (run / "run.json").write_text('{"planrunner_run": 1}'),
    "a newer format": lambda run: (run / "run.json").write_text('{"planrunner_run": 2}'),
    "samples": lambda run: flip(run / "segments" / "0002-P2.parquet"),
    "samples gone": lambda run: (run / "segments" / "0001-P1.parquet").unlink(),
    "journal": lambda run: flip(run / "journal.jsonl", 400),
    "last line": lambda run: flip(run / "journal.jsonl", -100),
    "end cut off": lambda run: (run / "journal.jsonl").write_bytes((run / "journal.jsonl").read_bytes()[:-3]),
    "last event removed": lambda run: (run / "journal.jsonl").write_bytes(
        b"".join((run / "journal.jsonl").read_bytes().splitlines(keepends=True)[:-1])
    ),
    "journal gone": lambda run: (run / "journal.jsonl").unlink(),
    "journal empty": lambda run: (run / "journal.jsonl").write_bytes(b""),
    "seal": lambda run: (run / "seal.json").write_text(
        (run / "seal.json").read_text().replace('"events": 6', '"events": 5')
    ),
    "seal is not JSON": lambda run: (run / "seal.json").write_text("[]"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_change_is_found(run: Path, change: str) -> None:
    CHANGES[change](run)
    with pytest.raises(IntegrityError, match=str(run)):
        RunReader.open(run).recording(SCHEDULE)


def test_a_digest_changed_in_the_seal_is_found(run: Path) -> None:
    seal = json.loads((run / "seal.json").read_text())
    seal["files"]["segments/0001-P1.parquet"] = "0" * 64
    del seal["digest"]
    (run / "seal.json").write_bytes(formats.digested(seal))
    with pytest.raises(IntegrityError, match="0001-P1"):
        RunReader.open(run)


def test_an_event_of_an_unknown_kind_is_reported(run: Path, tmp_path: Path) -> None:
    with RunWriter.create(tmp_path, "p", b"", b"", {}) as writer:
        writer.note("telepathy", with_whom="table")
    with pytest.raises(IntegrityError, match="unknown kind 'telepathy'"):
        RunReader.open(writer.path)
    with RunWriter.create(tmp_path, "p", b"", b"", {}) as writer:
        writer.note("stopped", how=3, reason="r")
    with pytest.raises(IntegrityError, match="how: 3 is not of type string"):
        RunReader.open(writer.path)


def test_not_a_run_folder(tmp_path: Path) -> None:
    for opened in (RunReader.open, RunWriter.reopen):
        with pytest.raises(InputError, match="not a run folder"):
            opened(tmp_path)


def test_a_plan_that_does_not_fit_the_recording(run: Path) -> None:
    with pytest.raises(IntegrityError, match="segment 2 was recorded as 'P2'"):
        RunReader.open(run).recording(Schedule((segment(0),), 1.0))


# -- one writer at a time --------------------------------------------------------------------------------------------------


def test_two_writers_are_refused(tmp_path: Path) -> None:
    with RunWriter.create(tmp_path, "p", b"", b"", {}) as writer:
        with pytest.raises(InputError, match="another planrunner process is writing this run"):
            RunWriter.reopen(writer.path)
        imports = "from planrunner.archive.run_folder import RunWriter; from pathlib import Path"
        script = f"{imports}; RunWriter.reopen(Path({str(writer.path)!r}))"
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
        assert "another planrunner process is writing this run" in done.stderr
    RunWriter.reopen(writer.path).close()


def test_a_finished_run_is_opened_again_only_with_a_reason(run: Path) -> None:
    with pytest.raises(InputError, match="finished and sealed"):
        RunWriter.reopen(run)
    sealed = json.loads((run / "seal.json").read_text())
    with RunWriter.reopen(run, reason="P2 was bumped") as writer:
        writer.reject(1, "somebody leaned on the table")
        assert writer.next_segment == 1
        write_segment(writer, SCHEDULE.segments[1], rows=50)
        between = RunReader.open(run)  # the journal has gone on after its seal
        assert not between.sealed
        writer.finish()
    reader = RunReader.open(run)
    assert [item.statistics.count for item in reader.recording(SCHEDULE)] == [100, 50]
    (rejected,) = reader.rejected()
    assert (rejected.reason, rejected.parts[0].file) == ("somebody leaned on the table", "segments/0002-P2.parquet")
    assert reader.acknowledged()[1].parts[0].file == "segments/0002-P2.try2.parquet"
    assert reader.seal is not None
    assert (
        sealed["files"].items() - {("journal.jsonl", sealed["files"]["journal.jsonl"])} <= reader.seal["files"].items()
    )
    assert reader.check_digests() == 6


def test_a_stray_part_does_not_undo_what_counts(tmp_path: Path) -> None:
    """A kept segment lost its last part's event to a full disk: the part is set aside, the segment still counts."""
    with RunWriter.create(tmp_path, "p", b"", b"", {}) as writer:
        write_segment(writer, SCHEDULE.segments[0])
    stray = writer.path / "segments" / "0001-P1.part002.parquet"
    shutil.copy(writer.path / "segments" / "0001-P1.parquet", stray)
    with RunWriter.reopen(writer.path) as again:
        assert again.next_segment == 1
    reader = RunReader.open(writer.path)
    assert [item.parts[0].file for item in reader.rejected()] == ["segments/0001-P1.part002.parquet"]
    assert [item.label for item in reader.acknowledged()] == ["P1"]


# -- where it cannot be written --------------------------------------------------------------------------------------------


def test_runs_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be written: .*") as caught:
        RunWriter.create(tmp_path / "file", "p", b"", b"", {})
    assert caught.value.findings[0].code == "runs-unwritable"
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        tmp_path.chmod(0o500)
        with pytest.raises(InputError, match="Permission denied"):
            RunWriter.create(tmp_path, "p", b"", b"", {})


def test_space_is_asked_before_the_first_move(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hour = Schedule((segment(0, dwell=3600.0), segment(1, dwell=3600.0, sample_rate=10.0), segment(2, dwell=None)), 0.0)
    needed = space.recording_bytes(hour, 1000.0, 3)
    samples = (3_600_000 + 36_000) * 4 * 8
    assert samples < needed < 1.2 * samples + 20e6
    with RunWriter.create(tmp_path, "p", b"", b"", {}) as writer:
        time = np.arange(200_000) / 1000
        writer.begin(segment(0), 0.0, dict.fromkeys("xyz", "V"))
        noise = np.random.default_rng(0).standard_normal((3, len(time)))
        writer.append(Block(time, dict(zip("xyz", noise, strict=True))), 0.0)
        writer.acknowledge(0.0, {}, {})
    written = sum(path.stat().st_size for path in writer.path.rglob("*") if path.is_file())
    assert written < space.recording_bytes(Schedule((segment(0, dwell=200.0),), 0.0), 1000.0, 3)
    space.require_space(tmp_path / "not" / "yet", 1000)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=50_000_000))
    with pytest.raises(InputError, match=r"needs up to 1\.0 GB, but the disk has only 50 MB free"):
        space.require_space(tmp_path, 1_000_000_000)


# -- analyses --------------------------------------------------------------------------------------------------------------


def test_analyses_are_numbered_and_never_touched(run: Path) -> None:
    first = add_analysis(run, {"results.json": b"{}", "report.html": b"<html>"}).path
    before = {path.name: path.read_bytes() for path in first.iterdir()}
    second = add_analysis(run, {"results.json": b"{1}"}).path
    assert [path.name for path in analyses(run)] == ["1", "2"]
    assert {path.name: path.read_bytes() for path in first.iterdir()} == before
    assert [one.path for one in RunReader.open(run).analyses] == [first, second]
    RunReader.open(run).check_digests()


@pytest.mark.parametrize("change", ["edit", "remove", "add"])
def test_a_changed_analysis_is_found(run: Path, change: str) -> None:
    folder = add_analysis(run, {"results.json": b"{}", "summary.md": b"#"}).path
    if change == "edit":
        (folder / "results.json").write_bytes(b"{ }")
    elif change == "remove":
        (folder / "summary.md").unlink()
    else:
        (folder / "more.txt").write_text("x")
    with pytest.raises(IntegrityError, match=r"changed|missing|added"):
        RunReader.open(run)


def test_what_a_killed_analysis_leaves_is_passed_over(run: Path) -> None:
    add_analysis(run, {"a": b"1"})
    (run / "analyses" / ".123-abcd.partial").mkdir()
    assert add_analysis(run, {"a": b"2"}).path.name == "2"
    RunReader.open(run).check_digests()


def test_two_analyses_at_the_same_time_get_two_numbers(run: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from planrunner.archive.run_reader import RunReader\n"
        "from planrunner.archive.analyses import add_analysis\n"
        f"reader = RunReader.open(Path({str(run)!r}))\n"
        "for i in range(15): add_analysis(reader.folder, {'a': sys.argv[1].encode() + bytes([i])}, reader.basis)"
    )
    running = [subprocess.Popen([sys.executable, "-c", script, name]) for name in ("one", "two")]
    assert [process.wait() for process in running] == [0, 0]
    assert [path.name for path in analyses(run)] == [str(number) for number in range(1, 31)]
    assert len({(path / "a").read_bytes() for path in analyses(run)}) == 30


@pytest.mark.parametrize("name", ["../x", "a/b", "", "digests.json", ".."])
def test_names_of_an_analysis_stay_in_its_folder(run: Path, name: str) -> None:
    with pytest.raises(ValueError, match="not a file name"):
        add_analysis(run, {name: b""})
