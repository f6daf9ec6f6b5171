"""Verification of runs: every change of a sealed run is found and named, and an untouched run has none.

Reduced samples run as slow tests; PLANRUNNER_FLIPS sets the number of random flips.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from planrunner.archive.run_folder import RunWriter
from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.tasks.verify import Verification, runs_beneath, verify_run
from tests.forging import evidence, flip, lines, rechain, reseal, rewrite, swap, with_digest, write_run

ROOT = Path(__file__).parents[2]
FLIPS = int(os.environ.get("PLANRUNNER_FLIPS", "1000"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("verified"))


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / made.name))


def kinds(run: Path) -> set[str]:
    return {change for change, _ in verify_run(run).changes}


def set_time(number: int, at: str) -> Callable[[list[dict]], object]:
    return lambda events: events[number].update(at=at)


FORGERIES: dict[str, tuple[Callable[[Path], object], str]] = {
    "samples altered": (lambda run: flip(run / "segments" / "0002-P2.parquet", 100, 1), "altered"),
    "plan altered": (lambda run: (run / "plan.yaml").write_bytes(b"title: Plan\n"), "altered"),
    "results altered": (lambda run: (run / "analyses/1/results.json").write_bytes(b'{"x": 9}'), "altered"),
    "samples removed": (lambda run: (run / "segments" / "0002-P2.parquet").unlink(), "removed"),
    "run.json removed": (lambda run: (run / "run.json").unlink(), "removed"),
    "journal removed": (lambda run: (run / "journal.jsonl").unlink(), "removed"),
    "seal removed": (lambda run: (run / "seal.json").unlink(), "removed"),
    "results removed": (lambda run: (run / "analyses/2/results.json").unlink(), "removed"),
    "first analysis removed": (lambda run: shutil.rmtree(run / "analyses/1"), "removed"),
    "samples added": (lambda run: (run / "segments/0004-P4.parquet").write_bytes(b"PAR1"), "added"),
    "note added": (lambda run: (run / "note.txt").write_bytes(b""), "added"),
    "report added": (lambda run: (run / "analyses/1/report.html").write_bytes(b""), "added"),
    "samples exchanged": (
        lambda run: swap(run / "segments/0001-P1.parquet", run / "segments/0002-P2.parquet"),
        "reordered",
    ),
    "plan and bench exchanged": (lambda run: swap(run / "plan.yaml", run / "bench.yaml"), "reordered"),
    "files of an analysis exchanged": (
        lambda run: swap(run / "analyses/1/results.json", run / "analyses/1/summary.md"),
        "reordered",
    ),
    "lines exchanged": (lambda run: lines(run, lambda found: found.insert(3, found.pop(4))), "reordered"),
    "line repeated": (lambda run: lines(run, lambda found: found.insert(4, found[2])), "reordered"),
    "line removed": (lambda run: lines(run, lambda found: found.pop(4)), "cut"),
    "last lines removed": (lambda run: lines(run, lambda found: found.__delitem__(slice(-2, None))), "cut"),
    "journal cut in a line": (lambda run: lines(run, lambda found: found.append(found.pop()[:-9])), "cut"),
    "bytes after the seal": (lambda run: lines(run, lambda found: found.append(b'{"seq":')), "added"),
    "re-chained": (lambda run: rechain(run, lambda events: events[0].update(run="x")), "altered"),
    "re-chained and cut": (lambda run: rechain(run, lambda events: events.__delitem__(slice(5, None))), "cut"),
    "re-chained and sealed": (
        lambda run: rewrite(run, lambda events: events[-1].update(at="2026-01-01T00:00:00.0+00:00")),
        "altered",
    ),
    "sealed again": (lambda run: reseal(run, sealed="2099-01-01T00:00:00.000000+00:00"), "re-sealed"),
    "seal dated before the run": (lambda run: reseal(run, sealed="2020-01-01T00:00:00.000000+00:00"), "back-dated"),
    "events dated before the run": (
        lambda run: rewrite(run, set_time(-1, "2020-01-01T00:00:00.000000+00:00")),
        "back-dated",
    ),
    "an event in the middle dated back": (
        lambda run: rewrite(run, set_time(4, "2020-01-01T00:00:00.000000+00:00")),
        "back-dated",
    ),
    "clock in the future": (
        lambda run: rewrite(run, set_time(-1, "2199-01-01T00:00:00.000000+00:00")),
        "back-dated",
    ),
    "newest analysis dated back": (
        lambda run: (run / "analyses/2/digests.json").write_bytes(
            with_digest(
                json.loads((run / "analyses/2/digests.json").read_bytes())
                | {"made": "2020-01-01T00:00:00.000000+00:00"}
            )
        ),
        "back-dated",
    ),
}


def test_an_untouched_run_has_no_changes(run: Path) -> None:
    found = verify_run(run)
    assert (found.changes, found.remarks, found.sealed) == ((), (), True)


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forgery_is_found_and_named(run: Path, forgery: str) -> None:
    forge, change = FORGERIES[forgery]
    forge(run)
    assert change in kinds(run)


def test_the_digest_of_a_seal_is_that_of_the_file_without_it(run: Path) -> None:
    for path in (run / "seal.json", run / "analyses" / "1" / "digests.json"):
        assert with_digest(json.loads(path.read_bytes())) == path.read_bytes()


def test_one_flip_in_each_file(run: Path) -> None:
    for path in evidence(run):
        before = path.read_bytes()
        flip(path, len(before) // 2, 4)
        assert kinds(run), path
        path.write_bytes(before)
    assert not kinds(run)


@pytest.mark.parametrize("key", ["seq", "at", "event", "previous"])
def test_a_line_without_one_of_the_common_keys_is_found(run: Path, key: str) -> None:
    """The first line and the last, at which the verification keeps the time."""
    for number in (0, -1):
        before = (run / "journal.jsonl").read_bytes()
        changed = before.splitlines(keepends=True)
        changed[number] = changed[number].replace(f'"{key}":'.encode(), f'"{key}_":'.encode())
        (run / "journal.jsonl").write_bytes(b"".join(changed))
        assert kinds(run)
        (run / "journal.jsonl").write_bytes(before)


@pytest.mark.slow
def test_flips_of_every_byte_position_of_the_small_files(run: Path) -> None:
    """Every byte of the seal and of a list of digests, whose bytes no other file has to repeat."""
    for path in (run / "seal.json", run / "analyses" / "2" / "digests.json"):
        before = path.read_bytes()
        for place in range(len(before)):
            flip(path, place, 1 << (place % 8))
            assert kinds(run), (path.name, place)
            path.write_bytes(before)


@pytest.mark.slow
def test_random_flips(run: Path) -> None:
    rng = random.Random(17)
    files = evidence(run)
    for _ in range(FLIPS):
        path = rng.choice(files)
        before = path.read_bytes()
        place, bits = rng.randrange(len(before)), 1 << rng.randrange(8)
        flip(path, place, bits)
        assert kinds(run), (path.name, place, bits)
        path.write_bytes(before)
    assert not kinds(run)


@pytest.mark.slow
def test_truncations(run: Path) -> None:
    rng = random.Random(18)
    for path in evidence(run):
        before = path.read_bytes()
        for size in {0, 1, len(before) - 1, *(rng.randrange(len(before)) for _ in range(12))}:
            path.write_bytes(before[:size])
            assert kinds(run), (path.name, size)
        path.write_bytes(before)
    assert not kinds(run)


@pytest.mark.slow
def test_swaps_of_any_two_lines_and_any_two_files(run: Path) -> None:
    count = len((run / "journal.jsonl").read_bytes().splitlines())
    before = (run / "journal.jsonl").read_bytes()
    for i in range(count):
        for k in range(i):

            def exchange(found: list[bytes], i: int = i, k: int = k) -> None:
                found[i], found[k] = found[k], found[i]

            lines(run, exchange)
            assert kinds(run) & {"reordered", "altered"}, (i, k)
            (run / "journal.jsonl").write_bytes(before)
    files = evidence(run)
    for i, one in enumerate(files):
        for other in files[:i]:
            if one.read_bytes() != other.read_bytes():
                swap(one, other)
                assert kinds(run), (one.name, other.name)
                swap(one, other)
    assert not kinds(run)


# -- the command -----------------------------------------------------------------------------------------------------------


def test_the_command_says_what_was_changed(made: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(made)]) == 0
    said = capsys.readouterr().out
    assert f"{made}: unchanged" in said
    assert hashlib.sha256((made / "seal.json").read_bytes()).hexdigest() in said
    (run / "segments" / "0001-P1.parquet").unlink()
    assert main(["verify", str(made), str(run)]) == 4
    said = capsys.readouterr().out
    assert "removed: " in said and "0001-P1.parquet" in said and "2 runs: 1 changed" in said


def test_the_json_of_a_verification_matches_its_schema(
    made: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swap(run / "plan.yaml", run / "bench.yaml")
    assert main(["verify", "--json", str(made), str(run), "nowhere"]) == 4
    entries = json.loads(capsys.readouterr().out)
    schema = Draft202012Validator(json.loads((ROOT / "schemas" / "verification.schema.json").read_bytes()))
    for entry in entries:
        schema.validate(entry)
    assert [entry["exit_code"] for entry in entries] == [0, 4, 2]
    assert entries[0]["changes"] == [] and {one["change"] for one in entries[1]["changes"]} == {"reordered"}
    assert entries[0]["seal"] == hashlib.sha256((made / "seal.json").read_bytes()).hexdigest()


def test_an_archive_is_searched_for_runs(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    year = tmp_path / "2026" / "week 1"
    year.mkdir(parents=True)
    shutil.copytree(run, year / "other")
    (tmp_path / "link").symlink_to(year)
    assert runs_beneath(tmp_path) == sorted([year / "other", run])
    assert main(["verify", str(tmp_path), "--all"]) == 0
    assert "2 runs: all unchanged" in capsys.readouterr().out
    (year / "other" / "journal.jsonl").unlink()
    (year / "other" / "run.json").unlink()
    assert main(["verify", str(tmp_path), "--all"]) == 4
    with pytest.raises(InputError, match="no run folder"):
        runs_beneath(run / "segments")


def test_an_unfinished_run_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RunWriter.create(tmp_path, "p", b"", b"", {}, "flushed") as writer:
        pass
    found: Verification = verify_run(writer.path)
    assert not found.sealed and [one.code for one in found.remarks] == ["run-not-sealed"]
    assert main(["verify", str(writer.path)]) == 0
    assert "NOT SEALED" in capsys.readouterr().out
