"""A run folder from a stranger: links, pipes, devices, holes and lies in it, at every name, for readers and for the writer."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.archive import formats, journal
from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import verify
from planrunner.base import guarded_folder
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder, NotOrdinaryError
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Schedule, Segment
from tests.archive.analyses import add_analysis

POSIX = pytest.mark.skipif(os.name == "nt", reason="links, pipes and devices as POSIX has them")
SCHEDULE = Schedule(tuple(Segment(i, f"P{i + 1}", None, "unknown", Rest(), dwell=1.0) for i in range(2)), 2.0)
SECRET = b"what nobody else may read or change\n"


@pytest.fixture(params=["relative", "by path"])
def ways(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways of guarding a folder: by an open folder, and by looking before and after."""
    if request.param == "by path":
        monkeypatch.setattr(guarded_folder, "RELATIVE", False)
    elif not guarded_folder.RELATIVE:
        pytest.skip("this system opens no names relative to a folder")
    return str(request.param)


def take(writer: RunWriter, item: Segment, rows: int = 20) -> None:
    writer.begin(item, float(item.index), {"x": "deg/s"})
    time = item.index + np.arange(rows) / rows
    writer.append(Block(time, {"x": np.sin(time)}), item.index + 1.0)
    writer.acknowledge(item.index + 1.0, {}, {})


def write_run(root: Path, segments: int) -> Path:
    with RunWriter.create(root, "p", b"plan", b"bench", {}, "flushed") as writer:
        for item in SCHEDULE.segments[:segments]:
            take(writer, item)
        if segments == len(SCHEDULE.segments):
            writer.finish()
    return writer.path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A sealed run with two analyses, and one that was cut short with one."""
    root = tmp_path_factory.mktemp("runs")
    sealed, cut = write_run(root, 2), write_run(root, 1)
    for run, count in ((sealed, 2), (cut, 1)):
        for number in range(count):
            add_analysis(run, {"results.json": b"{}", "summary.md": b"# %d" % number})
    (cut / "watchdog.txt").write_text("the table was stopped\n")
    return sealed, cut


@pytest.fixture
def sealed(runs: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(runs[0], tmp_path / "run"))


@pytest.fixture
def cut(runs: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(runs[1], tmp_path / "run"))


def read_all(run: Path) -> None:
    for item in RunReader.open(run).recording(SCHEDULE):
        list(item.blocks(["x"]))


def go_on(run: Path) -> None:
    with RunWriter.reopen(run) as writer:
        writer.take_watchdog_report()
        for item in SCHEDULE.segments[writer.next_segment :]:
            take(writer, item)
        writer.finish()


# -- what stands at a name -------------------------------------------------------------------------------------------------

NAMES = (
    "run.json",
    "plan.yaml",
    "bench.yaml",
    "journal.jsonl",
    "segments",
    "segments/0001-P1.parquet",
    "analyses",
    "analyses/1",
    "analyses/1/digests.json",
    "analyses/1/results.json",
    ".lock",
    ".origin",
    "watchdog.txt",
)


def as_link(path: Path, outside: Path) -> None:
    """The thing itself moves outside, and a link to it stands in its place: its digests are right."""
    shutil.move(path, outside)
    path.symlink_to(outside)


def as_hard_link(path: Path, outside: Path) -> None:
    if path.is_dir():
        pytest.skip("folders have one name")
    os.link(path, outside)


def as_pipe(path: Path, outside: Path) -> None:
    clear(path)
    os.mkfifo(path)


def as_device(path: Path, outside: Path) -> None:
    clear(path)
    path.symlink_to("/dev/zero")


def as_other_kind(path: Path, outside: Path) -> None:
    folder = path.is_dir()
    clear(path)
    path.write_bytes(b"") if folder else path.mkdir()


def clear(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)


def content(path: Path) -> list[tuple[str, bytes]]:
    if path.is_file():
        return [("", path.read_bytes())]
    return sorted((str(one.relative_to(path)), one.read_bytes()) for one in path.rglob("*") if one.is_file())


@POSIX
@pytest.mark.parametrize("change", [as_link, as_hard_link, as_pipe, as_device, as_other_kind])
@pytest.mark.parametrize("name", NAMES)
def test_nothing_but_plain_files_and_folders(
    cut: Path, tmp_path: Path, name: str, change: Callable[[Path, Path], None], ways: str
) -> None:
    outside = tmp_path / "outside"
    (cut / ".origin").write_bytes((cut / ".origin").read_bytes() if (cut / ".origin").exists() else b"0")
    change(cut / name, outside)
    before = content(outside) if outside.exists() else []
    with pytest.raises(IntegrityError, match=name.split("/")[-1].replace(".", r"\.")):
        read_all(cut)
    with pytest.raises(IntegrityError):
        go_on(cut)
    assert [finding for finding in verify(cut) if finding.severity == "error"]
    assert (content(outside) if outside.exists() else []) == before


@POSIX
@pytest.mark.parametrize(
    "name",
    [
        "seal.json.partial",
        "segments/0002-P2.parquet.partial",
        "segments/0001-P1.parquet.partial",
        "analyses/.7-0.partial",
        "watchdog.partial",
    ],
)
def test_a_link_aside_is_not_written_through(cut: Path, tmp_path: Path, name: str, ways: str) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(SECRET)
    (cut / name).symlink_to(secret)
    with pytest.raises(IntegrityError, match="a link that planrunner did not write"):
        go_on(cut)
    assert secret.read_bytes() == SECRET


@POSIX
def test_a_link_that_comes_while_the_run_is_written_is_replaced(cut: Path, tmp_path: Path, ways: str) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(SECRET)
    with RunWriter.reopen(cut) as writer:
        for name in ("seal.json.partial", "seal.json", "segments/0002-P2.parquet.partial", "segments/0002-P2.parquet"):
            (cut / name).symlink_to(secret)
        take(writer, SCHEDULE.segments[1])
        writer.finish()
    assert secret.read_bytes() == SECRET
    assert RunReader.open(cut).sealed


@POSIX
def test_a_report_of_the_watchdog_that_is_a_link_is_not_copied(cut: Path, tmp_path: Path, ways: str) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(SECRET)
    with RunWriter.reopen(cut) as writer:
        (cut / "watchdog.txt").unlink()
        (cut / "watchdog.txt").symlink_to(secret)
        with pytest.raises(NotOrdinaryError, match="a link"):
            writer.take_watchdog_report()
    assert SECRET.strip() not in (cut / "journal.jsonl").read_bytes()
    from planrunner.bench.watchdog_report import append_report

    append_report(cut, "what the watchdog did\n")
    assert (secret.read_bytes(), (cut / "watchdog.txt").read_bytes()) == (SECRET, b"what the watchdog did\n")


@POSIX
def test_a_file_that_is_exchanged_between_the_look_and_the_opening(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ways: str
) -> None:
    folder, secret = tmp_path / "folder", tmp_path / "secret"
    folder.mkdir()
    secret.write_bytes(SECRET)
    (folder / "file").write_bytes(b"harmless")
    opened = os.open

    def exchanged(path: Any, flags: int, *rest: Any, **more: Any) -> int:
        if str(path).endswith("file"):
            (folder / "file").unlink()
            (folder / "file").symlink_to(secret)
        return opened(path, flags, *rest, **more)

    guarded = GuardedFolder.open(folder)
    monkeypatch.setattr(os, "open", exchanged)
    for attempt in (lambda: guarded.read("file", 100), lambda: guarded.open_existing("file")):
        with pytest.raises(NotOrdinaryError):
            attempt()
        clear(folder / "file")
        (folder / "file").write_bytes(b"harmless")
    assert secret.read_bytes() == SECRET


@POSIX
def test_a_folder_that_is_exchanged_meanwhile(tmp_path: Path, ways: str) -> None:
    """The open folder stays the one that was opened; where it is looked at by its path, the exchange is noticed."""
    folder, other = tmp_path / "folder", tmp_path / "other"
    for place, text in ((folder, b"own"), (other, SECRET)):
        place.mkdir()
        (place / "file").write_bytes(text)
    guarded = GuardedFolder.open(folder)
    folder.rename(tmp_path / "moved")
    folder.symlink_to(other)
    if ways == "relative":
        assert guarded.read("file", 100) == b"own"
    else:
        with pytest.raises(NotOrdinaryError, match="replaced"):
            guarded.read("file", 100)


@pytest.mark.parametrize("name", ["../secret", "a/b", "a\\b", "", ".", "..", "a\0b"])
def test_a_name_is_one_component(tmp_path: Path, name: str) -> None:
    guarded = GuardedFolder.open(tmp_path)
    for attempt in (guarded.entry, guarded.open_new, guarded.remove, guarded.folder, guarded.open_existing):
        with pytest.raises(ValueError, match="not a single file name"):
            attempt(name)


# -- sizes -----------------------------------------------------------------------------------------------------------------


@POSIX
@pytest.mark.parametrize(
    "name", ["journal.jsonl", "run.json", "bench.yaml", "segments/0001-P1.parquet", "analyses/1/results.json"]
)
def test_a_file_of_three_gigabytes_is_not_read(cut: Path, name: str) -> None:
    (cut / name).unlink()
    with (cut / name).open("wb") as file:
        file.truncate(3 * 10**9)  # a hole: it takes no room on the disk
    with pytest.raises(IntegrityError):
        RunReader.open(cut)


def test_a_journal_without_an_end_of_line_is_not_read_whole(cut: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    opened = GuardedFolder.open_file

    def watched(folder: GuardedFolder, name: str, limit: int) -> Any:
        file = opened(folder, name, limit)

        class Watched:
            def __enter__(self) -> Any:
                return self

            def __exit__(self, *_: object) -> None:
                file.close()

            def readline(self, size: int) -> bytes:
                asked.append(size)
                return file.readline(size)

            def read(self, size: int) -> bytes:
                return file.read(size)

        return Watched()

    with (cut / "journal.jsonl").open("r+b") as file:
        file.truncate(20 * 2**20)
    monkeypatch.setattr(GuardedFolder, "open_file", watched)
    with pytest.raises(IntegrityError, match="longer than"):
        list(journal.JournalScan(GuardedFolder.open(cut)))
    assert max(asked) <= journal.MOST_LINE + 1


def test_the_writer_keeps_to_what_the_reader_takes(cut: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with RunWriter.reopen(cut) as writer:
        monkeypatch.setattr(journal, "MOST_LINE", 200)
        with pytest.raises(OSError, match="is limited to"):
            writer.note("noticed", instrument="table", text="x" * 300)
    monkeypatch.undo()
    RunReader.open(cut)


# -- lies ------------------------------------------------------------------------------------------------------------------


def forge(run: Path, change: Callable[[dict[str, Any]], object], kind: str) -> None:
    """A journal with the first event of a kind changed, and the chain made right again."""
    lines, previous, changed = [], journal.FIRST, False
    for line in (run / "journal.jsonl").read_bytes().splitlines():
        event = json.loads(line)
        if event["event"] == kind and not changed:
            change(event)
            changed = True
        event["previous"] = previous
        data = json.dumps(event, separators=(",", ":")).encode()
        previous = hashlib.sha256(data).hexdigest()
        lines.append(data + b"\n")
    assert changed
    (run / "journal.jsonl").write_bytes(b"".join(lines))


def part(event: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = event["parts"][0]
    return found


LIES: dict[str, tuple[str, Callable[[dict[str, Any]], object]]] = {
    "rows 1e18": ("segment", lambda event: part(event).update(rows=1e18)),
    "rows ten to the 18": ("segment", lambda event: part(event).update(rows=10**18)),
    "rows -1": ("segment", lambda event: part(event).update(rows=-1)),
    "one row more": ("segment", lambda event: part(event).update(rows=21)),
    "no rows": ("segment", lambda event: part(event).update(rows=0)),
    "bytes": ("segment", lambda event: part(event).update(bytes=10**15)),
    "a number as truth": ("segment", lambda event: event.update(truncated=0)),
    "segment -1": ("segment", lambda event: event.update(segment=-1)),
    "segment of a million digits": ("segment", lambda event: event.update(segment=10**4000)),
    "a path": ("segment", lambda event: part(event).update(file="segments/../../secret.parquet")),
    "deep states": ("segment", lambda event: event.update(states={"executor": nested(70)})),
    "an unknown key": ("segment", lambda event: event.update(more=1)),
    "a time that is none": ("begun", lambda event: event.update(at="x")),
    "a time without an offset": ("begun", lambda event: event.update(at="2026-01-01T00:00:00")),
    "a year": ("begun", lambda event: event.update(at="0001-01-01T00:00:00+00:00")),
    "a second beginning": ("begun", lambda event: event.update(event="created")),
    "an unknown kind": ("begun", lambda event: event.update(event="telepathy")),
    "a kind that is no text": ("begun", lambda event: event.update(event=["begun"])),
    "another file of the run": ("created", lambda event: event["files"].update({"secret": "0" * 64})),
}


def nested(levels: int) -> Any:
    value: Any = 0
    for _ in range(levels):
        value = [value]
    return value


@pytest.mark.parametrize("lie", LIES)
def test_a_journal_that_lies_in_a_chain_that_is_right(cut: Path, lie: str) -> None:
    kind, change = LIES[lie]
    shutil.rmtree(cut / "analyses")
    forge(cut, change, kind)
    with pytest.raises(IntegrityError):
        read_all(cut)
    with pytest.raises(IntegrityError):
        go_on(cut)


@pytest.mark.parametrize(
    "text",
    [
        '{"clock":1e999}',
        '{"clock":NaN}',
        "[" * 100_000,
        '{"a":' * 990 + "1" + "}" * 990,
        "\ufeff{}",
        '"text"',
        '{"seq":' + "9" * 5000 + "}",
    ],
)
def test_lines_that_are_no_events(cut: Path, text: str) -> None:
    shutil.rmtree(cut / "analyses")
    with (cut / "journal.jsonl").open("ab") as file:
        file.write(text.encode() + b"\n")
    with pytest.raises(IntegrityError, match=r"journal\.jsonl:"):
        RunReader.open(cut)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("created", "x"),
        ("created", "9999-12-31T23:59:59+00:00"),
        ("run", "../../x"),
        ("info", {"a": nested(3)}),
        ("seed", 1.5),
    ],
)
def test_run_json_is_held_against_its_whole_schema(cut: Path, key: str, value: Any) -> None:
    shutil.rmtree(cut / "analyses")
    given = json.loads((cut / "run.json").read_bytes())
    data = json.dumps({**given, key: value}).encode()
    (cut / "run.json").write_bytes(data)
    forge(cut, lambda event: event["files"].update({"run.json": hashlib.sha256(data).hexdigest()}), "created")
    with pytest.raises(IntegrityError, match=key):
        RunReader.open(cut)


def floats(**columns: Any) -> pa.Table:
    return pa.table(columns).replace_schema_metadata({"planrunner_segment": "1"})


STEPS = np.arange(20.0)
FILES = {
    "text": floats(time=STEPS, x=[str(step) for step in STEPS]),
    "32 bit": floats(time=STEPS, x=STEPS.astype(np.float32)),
    "no time": floats(x=STEPS),
    "time falls": floats(time=-STEPS, x=STEPS),
    "time is no number": floats(time=np.full(20, np.nan), x=STEPS),
    "lists": floats(time=STEPS, x=[[step] for step in STEPS]),
    "too many columns": floats(**{"time": STEPS, **{f"x{number}": STEPS for number in range(1001)}}),
    "too many rows": floats(**{"time": np.arange(3e6), "x": np.zeros(3_000_000)}),
    "rows that the journal does not count": floats(time=STEPS[:19], x=STEPS[:19]),
    "no version": pa.table({"time": STEPS, "x": STEPS}),
}


@pytest.mark.parametrize("kind", FILES)
def test_samples_of_another_form_whose_digest_is_right(cut: Path, kind: str) -> None:
    shutil.rmtree(cut / "analyses")
    path = cut / "segments" / "0001-P1.parquet"
    pq.write_table(FILES[kind], path)
    data = path.read_bytes()
    rows = 20 if "journal" in kind else FILES[kind].num_rows
    right = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data), "rows": rows}
    forge(cut, lambda event: part(event).update(right), "segment")
    with pytest.raises(IntegrityError, match="0001-P1"):
        read_all(cut)


# -- the seal, the chain of analyses, and what does not belong ---------------------------------------------------------------


def codes(run: Path) -> list[str]:
    return [finding.code for finding in verify(run)]


def test_a_sealed_run_is_as_it_was_written(sealed: Path) -> None:
    assert verify(sealed) == []


def test_a_run_that_is_not_sealed_says_so_and_is_read(cut: Path) -> None:
    assert codes(cut) == ["run-not-sealed"]
    assert [finding.severity for finding in RunReader.open(cut).findings] == ["warning"]


@pytest.mark.parametrize("name", ["notes.txt", "segments/more.parquet", "segments/0009-P9.parquet", "analyses/x"])
def test_a_file_that_does_not_belong(runs: tuple[Path, Path], tmp_path: Path, name: str) -> None:
    for run, severity in ((runs[0], "error"), (runs[1], "warning")):
        folder = Path(shutil.copytree(run, tmp_path / f"{severity} run"))
        (folder / name).write_bytes(b"")
        assert severity in [finding.severity for finding in verify(folder) if finding.code != "run-not-sealed"] or (
            name.startswith("segments/0009") and severity == "warning"
        )
        if severity == "error":
            with pytest.raises(IntegrityError, match="did not write"):
                RunReader.open(folder)
        else:
            RunReader.open(folder)


def test_a_seal_that_is_missing(sealed: Path) -> None:
    (sealed / "seal.json").unlink()
    assert codes(sealed) == ["run-seal-removed"]
    with pytest.raises(IntegrityError, match="its seal is missing"):
        RunReader.open(sealed)
    with pytest.raises(IntegrityError, match="its seal is missing"):
        RunWriter.reopen(sealed)
    shutil.rmtree(sealed / "analyses")  # nothing tells of it now but the end of the journal
    assert codes(sealed) == ["run-seal-missing"]
    with pytest.raises(IntegrityError):
        RunReader.open(sealed)
    go_on(sealed)  # planrunner may have been ended just then
    assert verify(sealed) == []


def test_a_seal_that_is_missing_from_a_run_that_was_opened_again(sealed: Path) -> None:
    shutil.rmtree(sealed / "analyses")
    RunWriter.reopen(sealed, reason="a segment is to be taken again").close()
    assert codes(sealed) == ["run-not-sealed"]
    (sealed / "seal.json").unlink()
    assert "run-seal-removed" in codes(sealed)


def test_a_journal_that_was_cut_shows_in_an_analysis(cut: Path) -> None:
    lines = (cut / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (cut / "journal.jsonl").write_bytes(b"".join(lines[:-1]))
    assert "run-cut-short" in codes(cut)


def removed_and_moved_up(folder: Path) -> None:
    shutil.rmtree(folder / "2")
    (folder / "3").rename(folder / "2")


CHAIN: dict[str, Callable[[Path], object]] = {
    "removed": lambda folder: shutil.rmtree(folder / "2"),
    "removed and later ones moved up": removed_and_moved_up,
    "changed with its digests": lambda folder: rewrite(folder / "2"),
    "exchanged": lambda folder: (
        (folder / "1").rename(folder / "0x"),
        (folder / "2").rename(folder / "1"),
        (folder / "0x").rename(folder / "2"),
    ),
    "the first removed": lambda folder: shutil.rmtree(folder / "1"),
}


def rewrite(analysis: Path) -> None:
    (analysis / "results.json").write_bytes(b"[]")
    digests = json.loads((analysis / "digests.json").read_bytes())
    digests["files"]["results.json"] = hashlib.sha256(b"[]").hexdigest()
    del digests["digest"]
    (analysis / "digests.json").write_bytes(formats.digested(digests))


@pytest.mark.parametrize("change", CHAIN)
def test_analyses_are_a_chain(sealed: Path, change: str) -> None:
    add_analysis(sealed, {"results.json": b"{}"})
    assert verify(sealed) == []
    CHAIN[change](sealed / "analyses")
    missing = change in ("removed", "the first removed")
    assert ("run-file-missing" if missing else "run-analysis-chain") in codes(sealed)
    with pytest.raises(IntegrityError):
        RunReader.open(sealed)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_digests_without_a_chain_are_refused(sealed: Path, number: int) -> None:
    add_analysis(sealed, {"results.json": b"{}"})
    file = sealed / "analyses" / str(number) / "digests.json"
    digests = json.loads(file.read_bytes())
    kept = {name: digests[name] for name in ("made", "files")}
    for form in (1, 2, 3):
        file.write_text(json.dumps({"planrunner_digests": form, **kept}))
        assert ("run-changed" if form == formats.DIGESTS_FORMAT else "run-analysis-format") in codes(sealed)
        with pytest.raises(IntegrityError, match=r"digests\.json"):
            RunReader.open(sealed)


def test_an_analysis_in_an_older_format_is_moved_away_and_made_again(sealed: Path, tmp_path: Path) -> None:
    """All analyses of a run have the same older format, because a new one would refer to the one before it."""
    for folder in (sealed / "analyses").iterdir():
        (folder / "digests.json").write_text(json.dumps({"planrunner_digests": 2, "made": "", "files": {}}))
    assert set(codes(sealed)) == {"run-analysis-format"}
    for folder in sorted((sealed / "analyses").iterdir()):
        with pytest.raises(IntegrityError, match="in an older format") as raised:
            RunReader.open(sealed)
        said = str(raised.value)
        assert f"move the folder {folder} out" in said and f"`planrunner estimate {sealed}`" in said
        assert "version of planrunner that wrote" not in said
        folder.rename(tmp_path / f"old {folder.name}")
    assert verify(sealed) == [] and RunReader.open(sealed).analyses == ()
    assert add_analysis(sealed, {"results.json": b"{}"}).number == 1
    assert verify(sealed) == []


def test_analyses_outlive_a_segment_that_is_taken_again(sealed: Path) -> None:
    with RunWriter.reopen(sealed, reason="the door stood open") as writer:
        writer.reject(1, "the door stood open")
        assert add_analysis(sealed, {"results.json": b"{}"}).number == 3
        take(writer, SCHEDULE.segments[1])
        writer.finish()
    assert add_analysis(sealed, {"results.json": b"{}"}).number == 4
    assert verify(sealed) == []


def test_samples_of_rejected_segments_are_verified_too(sealed: Path) -> None:
    with RunWriter.reopen(sealed, reason="the door stood open") as writer:
        writer.reject(1, "the door stood open")
        take(writer, SCHEDULE.segments[1])
        writer.finish()
    path = sealed / "segments" / "0002-P2.parquet"
    data = bytearray(path.read_bytes())
    data[50] ^= 1
    path.write_bytes(data)
    assert verify(sealed, samples="sizes") == []
    assert codes(sealed) == ["run-changed"]
    with pytest.raises(IntegrityError, match="0002-P2"):
        RunWriter.reopen(sealed, reason="again")


def test_all_that_is_wrong_is_reported_at_once(sealed: Path) -> None:
    (sealed / "plan.yaml").write_bytes(b"other")
    (sealed / "segments" / "0001-P1.parquet").unlink()
    (sealed / "notes.txt").write_bytes(b"")
    with pytest.raises(IntegrityError) as caught:
        RunReader.open(sealed)
    assert all(name in str(caught.value) for name in ("plan.yaml", "0001-P1", "notes.txt"))


@POSIX
def test_no_open_files_are_left_behind(sealed: Path) -> None:
    before = len(os.listdir("/dev/fd"))
    for _ in range(20):
        RunReader.open(sealed).recording(SCHEDULE)
    assert len(os.listdir("/dev/fd")) <= before + 8


def test_not_a_run_folder(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "absent", Path(__file__)):
        with pytest.raises(InputError, match="not a run folder"):
            verify(place)
