"""Remote archives on a file system that writes piece by piece (here a folder, through fsspec), two commands at a time, and failures to
connect."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from planrunner.archive import remote
from planrunner.archive.remote import fetched, push_back, push_run
from planrunner.archive.verifying import verify
from planrunner.base.exclusive import COMMAND
from planrunner.base.findings import InputError
from planrunner.execution.stopping import StopRequest
from planrunner.tasks import run as running
from planrunner.tasks.check import check_plan
from planrunner.tasks.estimate import analyse_run
from tests.conftest import ROOT

fsspec = pytest.importorskip("fsspec")

_PLAN = ROOT / "tests" / "agreement" / "corpus" / "counts_that_alternate.yaml"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sealed run with an analysis."""
    folder = tmp_path_factory.mktemp("made") / "runs"
    sound = check_plan(_PLAN).sound()
    run, outcome = running.start(sound, info={}, runs=folder, stop=StopRequest(), durability="flushed", seed=1)
    assert outcome.ok
    analyse_run(run)
    return run


@pytest.fixture
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("PLANRUNNER_CACHE", str(tmp_path / "copies"))
    (tmp_path / "archive").mkdir()
    with COMMAND:
        yield tmp_path / "archive"


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (".lock", ".origin", "live.json", "pausing.json")
    }


def refused(action: Any, *given: Any) -> tuple[str, str]:
    with pytest.raises(InputError) as caught:
        action(*given)
    (found,) = caught.value.findings
    assert found.hint
    return found.code, found.message


@pytest.mark.parametrize("number", [0, 3, -1])
def test_a_push_that_was_killed_while_it_wrote_a_file_is_completed(
    number: int, made: Path, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """number: of the file. The last one is the seal."""
    from fsspec.implementations.local import LocalFileSystem

    total = len(contents(made))
    before, opened = LocalFileSystem.open, 0

    def interrupted(self: Any, path: str, mode: str = "rb", **options: Any) -> Any:
        nonlocal opened
        file = before(self, path, mode, **options)
        if mode == "wb":
            opened += 1
            if opened == number % total + 1:  # it has begun, and has no bytes yet
                raise ConnectionResetError("the network is gone")
        return file

    with monkeypatch.context() as broken:
        broken.setattr(LocalFileSystem, "open", interrupted)
        assert refused(push_run, made, f"file://{archive}")[0] == "remote-unreachable"
    assert not (archive / made.name / "seal.json").exists()
    fetched(f"file://{archive}")
    assert push_run(made, f"file://{archive}").written == total - number % total
    assert contents(archive / made.name) == contents(made)
    assert [one for one in verify(archive / made.name) if one.severity == "error"] == []


def test_a_command_keeps_its_copy_until_it_ends(made: Path, archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the second command would remove an analysis that the first one has not written to the archive yet."""
    url = f"file://{archive}/{made.name}"
    push_run(made, f"file://{archive}")
    code = f"import sys; from planrunner.archive.remote import fetched; fetched({url!r}); print(flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as first:
        assert first.stdout is not None and first.stdout.readline()
        monkeypatch.setattr(remote, "_PATIENCE", 0.2)
        code_, message = refused(fetched, url)
        assert (code_, message) == (
            "remote-in-use",
            "another planrunner command is using this archive on this computer",
        )
        monkeypatch.setattr(remote, "_PATIENCE", 30.0)
        assert first.stdin is not None
        first.stdin.close()
        assert contents(fetched(url)) == contents(made)  # waits until the first command has ended
    assert fetched(url) == fetched(url)


def test_an_analysis_that_is_gone_is_not_written_in_silence(made: Path, archive: Path) -> None:
    push_run(made, f"file://{archive}")
    copy = fetched(f"file://{archive}/{made.name}")
    analysis = analyse_run(copy)
    push_back(copy, analysis.folder)
    assert (archive / made.name / "analyses" / analysis.folder.name / "results.json").exists()
    shutil.rmtree(analysis.folder)
    shutil.rmtree(archive / made.name / "analyses" / analysis.folder.name)
    assert refused(push_back, copy, analysis.folder)[0] == "remote-not-written"


class _Unconnected(fsspec.AbstractFileSystem):  # type: ignore[name-defined,misc,unused-ignore]
    cachable = False

    def __init__(self, **_: object) -> None:
        raise _SshError("Error reading SSH protocol banner")


class _SshError(Exception):
    """As paramiko has them: of no class that Python knows."""


def test_a_failure_to_connect_is_a_message(made: Path, archive: Path) -> None:
    fsspec.register_implementation("unconnected", _Unconnected, clobber=True)
    said = "the archive cannot be used: Error reading SSH protocol banner"
    assert refused(fetched, "unconnected://server/archive") == ("remote-unreachable", said)
    assert refused(push_run, made, "unconnected://server/archive") == ("remote-unreachable", said)
    assert refused(fetched, "ftp://127.0.0.1:1/archive")[0] == "remote-unreachable"


@pytest.mark.parametrize("url", ["sftp://server/archive", "SSH://server/a", "zip://a::sftp://server/a.zip"])
def test_a_server_that_nobody_would_verify_is_refused(url: str, archive: Path) -> None:
    code, message = refused(fetched, url)
    assert code == "remote-refused" and "SFTP" in message
