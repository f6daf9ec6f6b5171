"""The index agrees with the run folders: after changes, with several writers, and whatever the folders hold."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from planrunner.archive.run_folder import RunWriter
from planrunner.base.findings import InputError
from planrunner.base.workers import ALONE, Workers
from planrunner.night.history.databases import INDEX
from planrunner.night.history.index import Index
from planrunner.night.history.rows import CircumstanceKind, RunFilter
from tests.night.history.made_runs import MadeRun, add_results, make_run

PATIENCE = 300.0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six runs of two devices on two benches."""
    archive = tmp_path_factory.mktemp("made")
    for number in range(6):
        make_run(
            archive,
            MadeRun(
                device=f"D{1 + number % 2}",
                days=number,
                values={"bias": (1.0 + number, 0.1), "slope": (2.0, 0.2)},
                bench=f"bench {1 + number // 3}",
                operator="ann" if number < 4 else "bob",
                limit=(0.0, 4.5),
            ),
            number,
        )
    grow_old(archive)
    return archive


@pytest.fixture
def archive(made: Path, tmp_path: Path) -> Path:
    """A copy of these runs to change."""
    shutil.copytree(made, tmp_path / "runs")  # keeps the times
    return tmp_path / "runs"


@pytest.fixture
def index(archive: Path, tmp_path: Path) -> Iterator[Index]:
    with Index.open(archive, str(tmp_path / "index.sqlite")) as opened:
        opened.refresh(workers=ALONE)
        yield opened


def grow_old(folder: Path) -> None:
    """Sets the time of everything to some days ago, as of runs that were finished then."""
    for path in sorted(folder.rglob("*"), reverse=True):
        status = path.stat()
        os.utime(path, ns=(status.st_atime_ns - 10**15, status.st_mtime_ns - 10**15))


def content(index: Index) -> str:
    """All that an index says, in one text."""
    runs = index.runs()
    return repr([(run, index.coefficients(run.folder), index.limits(run.folder)) for run in runs] + [*index.faults()])


def test_runs_are_listed_with_what_their_folders_say(index: Index) -> None:
    newest, *_, oldest = index.runs()
    assert (newest.folder, newest.device, newest.bench, newest.operator) == ("0005-calibration", "D2", "bench 2", "bob")
    assert (newest.created, newest.title, newest.origin) == (
        "2024-01-06T08:00:00.000000+00:00",
        "Title of calibration",
        "simulated",
    )
    assert (newest.state, newest.verdict, newest.analysis) == ("sealed", "fail", 1)
    assert oldest.verdict == "pass" and oldest.folder == "0000-calibration"
    assert {(one.kind, one.name): one.value for one in oldest.circumstances}[
        CircumstanceKind.FIRMWARE, "table"
    ] == "1.0"
    (bias, slope) = index.coefficients("0003-calibration")
    assert (bias.quantity, bias.value, bias.standard_uncertainty, bias.unit) == ("drift.bias", 4.0, 0.1, "deg/h")
    assert bias.degrees_of_freedom == float("inf") and slope.quantity == "drift.slope"
    assert [one.verdict for one in index.limits("0005-calibration")] == ["fail"]


@pytest.mark.parametrize(
    ("wanted", "folders"),
    [
        (RunFilter(device="D1"), "420"),
        (RunFilter(device="d?"), "543210"),
        (RunFilter(bench="bench 2", operator="ann"), "3"),
        (RunFilter(verdict="fail"), "54"),
        (RunFilter(plan="cal*"), "543210"),
        (RunFilter(plan="cal"), ""),
        (RunFilter(plan="%"), ""),
        (RunFilter(since="2024-01-03", until="2024-01-04"), "32"),
        (RunFilter(since="2024-01-03T08:00:00", until="2024-01-04T07:59:59+00:00"), "2"),
        (RunFilter(since="0001-01-01", until="9999-12-31"), "543210"),
        (RunFilter(since="0001-01-01T00:00+05:00", until="9999-12-31T23:59-05:00"), "543210"),
        (RunFilter(until="1000-01-01"), ""),
        (RunFilter(since="9999-12-31"), ""),
        (RunFilter(limit=2), "54"),
    ],
)
def test_filters(index: Index, wanted: RunFilter, folders: str) -> None:
    assert [run.folder[3] for run in index.runs(wanted)] == list(folders)
    if wanted.limit is None:
        assert index.count(wanted) == len(folders)


def test_a_date_that_is_none_is_refused(index: Index) -> None:
    with pytest.raises(InputError, match="'yesterday' is not a date"):
        index.runs(RunFilter(since="yesterday"))


def test_the_history_of_a_device_is_in_the_order_of_time(index: Index) -> None:
    points = index.history("D1", "drift.bias")
    assert [point.coefficient.value for point in points] == [1.0, 3.0, 5.0]
    assert [point.limits[0].verdict for point in points] == ["pass", "pass", "fail"]
    assert index.quantities("D1") == ["drift.bias", "drift.slope"]
    assert [(one.device, one.runs) for one in index.devices()] == [("D1", 3), ("D2", 3)]
    assert index.history("D*", "drift.bias") == []


def test_a_serial_number_with_wildcards_is_that_device(tmp_path: Path) -> None:
    for number, device in enumerate(["A*", "AB", "A\\*", "A?"]):
        make_run(tmp_path / "runs", MadeRun(device=device), number)
    with Index.open(tmp_path / "runs", str(tmp_path / "i")) as index:
        index.refresh(workers=ALONE)
        for device in ("A*", "AB", "A\\*", "A?"):
            assert [point.run.device for point in index.history(device, "drift.bias")] == [device]


def test_only_new_and_changed_runs_are_read_again(index: Index, archive: Path) -> None:
    assert index.refresh(workers=ALONE).read == 0
    add_results(archive / "0002-calibration", MadeRun(values={"bias": (9.0, 0.1)}))
    make_run(archive, MadeRun(device="D3"), 6)
    shutil.rmtree(archive / "0000-calibration")
    done = index.refresh(workers=ALONE)
    assert (done.read, done.removed) == (2, 1)
    assert index.coefficients("0002-calibration")[0].value == 9.0 and index.run("0002-calibration").analysis == 2  # type: ignore[union-attr]
    assert index.run("0000-calibration") is None and index.coefficients("0000-calibration") == ()


def test_a_change_right_after_reading_is_noticed_though_the_clock_of_the_files_is_coarse(
    archive: Path, index: Index
) -> None:
    """The same size and the same time: as after two analyses within one tick of the file system."""
    run = archive / "0001-calibration"
    times = os.stat(run / "analyses")
    os.utime(run / "analyses")  # now
    index.refresh(workers=ALONE)
    before = os.stat(run / "analyses").st_mtime_ns
    add_results(run, MadeRun(values={"bias": (7.0, 0.1)}))
    os.utime(run / "analyses", ns=(times.st_atime_ns, before))
    index.refresh(workers=ALONE)
    assert index.coefficients("0001-calibration")[0].value == 7.0


def test_a_rebuild_gives_the_same_index(index: Index, archive: Path, tmp_path: Path) -> None:
    before = content(index)
    assert index.refresh(rebuild=True, workers=ALONE).read == 6
    assert content(index) == before
    with Index.open(archive, str(tmp_path / "other.sqlite")) as other:
        assert other.refresh(workers=Workers(2)).read == 6
        assert content(other) == before


def test_a_run_that_is_being_written_is_in_the_index(index: Index, archive: Path) -> None:
    with RunWriter.create(
        archive, "growing", b"planrunner: 1\n", b"name: b\n", {"device_serial": "D9"}, "flushed"
    ) as writer:
        writer.note("instruments", instruments={"table": {"model": "T"}})
        index.refresh(rebuild=True, workers=ALONE)
        (row,) = index.runs(RunFilter(device="D9"))
        assert (row.state, row.verdict, row.analysis) == ("open", "not analysed", 0)
        writer.finish()
    index.refresh(workers=ALONE)
    (row,) = index.runs(RunFilter(device="D9"))
    assert row.state == "sealed" and not index.faults()


# -- folders that are not as planrunner writes them --------------------------------------------------------------------


def _tamper(path: Path, old: bytes, new: bytes) -> None:
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))


def hostile_journal(run: Path) -> None:
    _tamper(run / "journal.jsonl", b'"T"', b'"X"')


def hostile_results(run: Path) -> None:
    _tamper(run / "analyses" / "1" / "results.json", b"scale_factor", b"scale_fact0r")


def hostile_link(run: Path) -> None:
    (run / "run.json").unlink()
    (run / "run.json").symlink_to("/etc/passwd")


def hostile_pipe(run: Path) -> None:
    (run / "bench.yaml").unlink()
    os.mkfifo(run / "bench.yaml")


def hostile_empty(run: Path) -> None:
    (run / "journal.jsonl").write_bytes(b"")


def hostile_depth(run: Path) -> None:
    (run / "seal.json").write_bytes(b"[" * 100_000)


@pytest.mark.parametrize(
    "harm", [hostile_journal, hostile_results, hostile_link, hostile_pipe, hostile_empty, hostile_depth]
)
@pytest.mark.skipif(sys.platform == "win32", reason="pipes and links")
def test_a_damaged_folder_is_named_and_the_others_are_there(index: Index, archive: Path, harm: object) -> None:
    assert callable(harm)
    harm(archive / "0001-calibration")
    done = index.refresh(
        rebuild=harm is hostile_results, workers=ALONE
    )  # no new time: planrunner writes no file in an analysis twice
    assert [fault.folder for fault in done.faults] == ["0001-calibration"] and done.faults[0].message
    assert index.run("0001-calibration") is None and index.count() == 5
    assert index.coefficients("0001-calibration") == ()
    # The fault is a fact of the folder as it is: mended, it is read again.
    shutil.rmtree(archive / "0001-calibration")
    make_run(archive, MadeRun(), 1)
    assert index.refresh(workers=ALONE).faults == () and index.count() == 6


@pytest.mark.skipif(sys.platform == "win32", reason="links")
def test_links_to_folders_are_not_followed(archive: Path, index: Index, tmp_path: Path) -> None:
    outside = make_run(tmp_path / "outside", MadeRun(device="outside"))
    (archive / "link").symlink_to(outside, target_is_directory=True)
    assert index.refresh(workers=ALONE).faults == () and index.count() == 6


def test_texts_of_a_stranger_are_texts(tmp_path: Path) -> None:
    names = ["'; DROP TABLE runs; --", "\u202egnp", "x" * 5000, "a\0b"]
    for number, name in enumerate(names):
        make_run(tmp_path / "runs", MadeRun(device=name), number)
    with Index.open(tmp_path / "runs", str(tmp_path / "i")) as index:
        assert index.refresh(workers=ALONE).faults == ()
        found = {run.device for run in index.runs()}
        assert names[0] in found and "a\N{REPLACEMENT CHARACTER}b" in found and max(map(len, found)) == 2001


# -- the database ------------------------------------------------------------------------------------------------------


def test_without_an_option_the_index_is_not_in_the_archive(
    archive: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(INDEX, raising=False)
    before = sorted(archive.iterdir())
    with Index.open(archive) as index:
        index.refresh(workers=ALONE)
        assert Path(index.database).is_relative_to(os.environ["PLANRUNNER_STATE"])
    assert sorted(archive.iterdir()) == before
    monkeypatch.setenv(INDEX, str(tmp_path / "elsewhere"))
    with Index.open(archive) as index:
        assert index.database == str(tmp_path / "elsewhere")


def test_an_own_file_that_is_broken_is_set_aside(archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(INDEX, raising=False)
    with Index.open(archive) as index:
        index.refresh(workers=ALONE)
        file = Path(index.database)
    file.write_bytes(b"this is not a database, but long enough to be looked at" * 100)
    with Index.open(archive) as index:
        assert index.refresh(workers=ALONE).read == 6
    assert file.with_name(f"{file.name}.unreadable").exists()


def test_a_file_of_the_user_is_never_overwritten(archive: Path, tmp_path: Path) -> None:
    import sqlite3

    notes = tmp_path / "notes.txt"
    notes.write_text("not an index " * 200)
    other = tmp_path / "other.sqlite"
    connection = sqlite3.connect(other)
    connection.execute("CREATE TABLE mine (a)")
    connection.commit()
    connection.close()
    for file in (notes, other):
        before = file.read_bytes()
        with pytest.raises(InputError, match="index-unavailable"):
            Index.open(archive, str(file))
        assert file.read_bytes() == before
    with pytest.raises(InputError, match="not a kind of index"):
        Index.open(archive, "mysql://localhost/runs")


def test_an_index_of_another_version_is_made_again(archive: Path, tmp_path: Path) -> None:
    import sqlite3

    file = tmp_path / "index.sqlite"
    with Index.open(archive, str(file)) as index:
        index.refresh(workers=ALONE)
    connection = sqlite3.connect(file)
    connection.execute("UPDATE formats SET format = 99")
    connection.execute("ALTER TABLE runs RENAME COLUMN device TO serial")
    connection.commit()
    connection.close()
    with Index.open(archive, str(file)) as index:
        assert index.count() == 0 and index.refresh(workers=ALONE).read == 6


REBUILD = """
import sys
from pathlib import Path
from planrunner.base.workers import ALONE
from planrunner.night.history.index import Index
with Index.open(Path(sys.argv[1]), sys.argv[2]) as index:
    print("open", flush=True)
    sys.stdin.readline()
    for _ in range(int(sys.argv[3])):
        index.refresh(rebuild=True, workers=ALONE)
"""


def rebuilders(archive: Path, index: str, number: int, times: int) -> list[subprocess.Popen[str]]:
    """Processes that rebuild the index, all at the same time."""
    command = [sys.executable, "-c", REBUILD, str(archive), index, str(times)]
    started = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(number)
    ]
    for one in started:
        assert one.stdout is not None and one.stdout.readline() == "open\n", one.stderr and one.stderr.read()
    for one in started:
        assert one.stdin is not None
        one.stdin.write("\n")
        one.stdin.flush()
    return started


def end_of(processes: list[subprocess.Popen[str]]) -> None:
    for one in processes:
        _, said = one.communicate(timeout=PATIENCE)
        assert one.returncode == 0, said


def test_rebuilt_by_several_processes_while_runs_are_written(archive: Path, index: Index, tmp_path: Path) -> None:
    """A reader never misses a run that was there, and in the end all runs are in the index."""
    seen: list[int] = []
    over = threading.Event()

    def watch() -> None:
        with Index.open(archive, str(tmp_path / "index.sqlite")) as reader:
            while not over.is_set():
                runs = reader.runs(RunFilter(device="D1"))
                seen.append(len(runs))
                assert all(reader.coefficients(run.folder) for run in runs)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        processes = rebuilders(archive, str(tmp_path / "index.sqlite"), 2, 2)
        for number in range(6, 8):
            make_run(archive, MadeRun(device="D3"), number)
            index.refresh(workers=ALONE)
        end_of(processes)
    finally:
        over.set()
        watcher.join(PATIENCE)
    assert seen and set(seen) == {3}
    index.refresh(workers=ALONE)
    assert index.count() == 8 and not index.faults()
    with Index.open(archive, str(tmp_path / "fresh.sqlite")) as fresh:
        fresh.refresh(workers=ALONE)
        assert content(fresh) == content(index)


def test_a_writer_that_is_killed_leaves_an_index_that_goes_on(archive: Path, tmp_path: Path) -> None:
    file = str(tmp_path / "killed.sqlite")
    (process,) = rebuilders(archive, file, 1, 1000)
    with Index.open(archive, file) as index:
        while index.count() < 6:  # its first transaction
            pass
        process.kill()
        process.communicate(timeout=PATIENCE)
        index.refresh(workers=ALONE)
        assert index.count() == 6
        assert all(index.coefficients(run.folder) for run in index.runs())


def test_another_writer_that_does_not_end_is_reported(
    archive: Path, index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import planrunner.night.history.databases as databases

    monkeypatch.setattr(databases, "_WAIT", 0.01)
    with Index.open(archive, str(tmp_path / "index.sqlite")) as other, index._database.transaction():
        with pytest.raises(InputError, match="locked; the run folders are not affected"):
            other.refresh(rebuild=True, workers=ALONE)
        assert other.count() == 6
