"""Archives on an S3-compatible server that the tests start on the loopback interface."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from planrunner.archive.remote import Pushed, fetched, push_run, source_of_copy
from planrunner.archive.verifying import verify
from planrunner.base.exclusive import COMMAND
from planrunner.base.findings import InputError
from planrunner.execution.stopping import StopRequest
from planrunner.tasks import run as running
from planrunner.tasks.check import Document, check_plan
from planrunner.tasks.estimate import analyse_run
from tests.conftest import ROOT
from tests.in_process import planrunner

fsspec = pytest.importorskip("fsspec")
pytest.importorskip("s3fs")
moto = pytest.importorskip("moto.server")

_PLAN = ROOT / "tests" / "agreement" / "corpus" / "counts_that_alternate.yaml"
_URL = "s3://laboratory/archive"
_RUNS = 2


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("archive") / "runs"
    sound = check_plan(_PLAN).sound()
    for seed in range(_RUNS):
        run, outcome = running.start(sound, info={}, runs=folder, stop=StopRequest(), durability="flushed", seed=seed)
        assert outcome.ok
        analyse_run(run)
    return folder


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
    started = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    started.start()
    host, port = started.get_host_and_port()
    yield f"http://{host}:{port}"
    started.stop()


@pytest.fixture
def bucket(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The file system of an empty bucket; copies are in a folder of the test."""
    for name, value in {"ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b", "DEFAULT_REGION": "us-east-1"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    monkeypatch.setenv("PLANRUNNER_CACHE", str(tmp_path / "copies"))
    monkeypatch.setitem(fsspec.config.conf, "s3", {"endpoint_url": server})
    files = fsspec.filesystem("s3", use_listings_cache=False)
    if files.exists("laboratory"):
        files.rm("laboratory", recursive=True)
    files.mkdir("laboratory")
    with COMMAND:
        yield files
    files.clear_instance_cache()


def pushed(runs: Path) -> list[Path]:
    found = sorted(runs.iterdir())
    for run in found:
        push_run(run, _URL)
    return found


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (".lock", ".origin", "live.json", "pausing.json")
    }


def refusal(action: Any, *given: Any) -> str:
    with pytest.raises(InputError) as refused:
        action(*given)
    (found,) = refused.value.findings
    return f"{found.code}: {found.message}"


@pytest.mark.slow
def test_a_run_comes_back_byte_for_byte(bucket: Any, runs: Path) -> None:
    found = pushed(runs)
    copy = fetched(_URL)
    assert sorted(path.name for path in copy.iterdir()) == [run.name for run in found]
    for run in found:
        assert contents(copy / run.name) == contents(run)
        assert [one for one in verify(copy / run.name) if one.severity == "error"] == []
        assert fetched(f"{_URL}/{run.name}").name == run.name


@pytest.mark.slow
def test_a_second_push_writes_only_what_is_new(bucket: Any, runs: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(sorted(runs.iterdir())[0], tmp_path / sorted(runs.iterdir())[0].name))
    first = push_run(run, _URL)
    assert first.written == len(contents(run)) and first.present == 0
    assert push_run(run, _URL) == Pushed(0, first.written)
    analyse_run(run)
    added = len(contents(run)) - first.written
    assert added and push_run(run, _URL) == Pushed(added, first.written)


def test_what_is_there_is_never_replaced(bucket: Any, runs: Path) -> None:
    run = sorted(runs.iterdir())[0]
    push_run(run, _URL)
    path = f"laboratory/archive/{run.name}/plan.yaml"
    bucket.pipe_file(path, b"another plan")
    assert refusal(push_run, run, _URL).startswith("remote-differs: ")
    assert bucket.cat_file(path) == b"another plan"


def test_empty_objects_for_folders_are_ignored(bucket: Any, runs: Path) -> None:
    """Consoles and mounts of object storage make them."""
    run = sorted(runs.iterdir())[0]
    push_run(run, _URL)
    for key in ("", f"{run.name}/", f"{run.name}/segments/", f"{run.name}/analyses/1/"):
        bucket.call_s3("put_object", Bucket="laboratory", Key=f"archive/{key}", Body=b"")
    assert contents(fetched(_URL) / run.name) == contents(run)


@pytest.mark.slow
def test_a_race_for_a_file_is_lost_without_harm(bucket: Any, runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the look and the writing, somebody else writes the file: the server refuses ours."""
    run = sorted(runs.iterdir())[0]
    push_run(run, _URL)
    monkeypatch.setattr(type(bucket), "exists", lambda *_, **__: False)
    assert push_run(run, _URL).written == 0


@pytest.mark.slow
def test_an_interrupted_push_is_not_sealed_and_is_completed(bucket: Any, runs: Path) -> None:
    run = pushed(runs)[0]
    for name in ("seal.json", "journal.jsonl"):
        bucket.rm(f"laboratory/archive/{run.name}/{name}")
    push_run(run, _URL)
    assert contents(fetched(f"{_URL}/{run.name}")) == contents(run)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["..", "a\\b", "a:b", "a*b"])
def test_a_name_that_could_lead_elsewhere_is_refused(bucket: Any, runs: Path, name: str) -> None:
    run = pushed(runs)[0]
    key = f"archive/{run.name}/segments/{name}/x" if name == ".." else f"archive/{run.name}/segments/{name}"
    bucket.call_s3("put_object", Bucket="laboratory", Key=key, Body=b"x")
    assert refusal(fetched, _URL).startswith("remote-refused: an entry has the name")


@pytest.mark.slow
def test_a_file_that_is_too_large_is_refused(bucket: Any, runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pushed(runs)
    monkeypatch.setattr("planrunner.archive.remote.MOST_BYTES", 100)
    assert "at most 100 are allowed" in refusal(fetched, _URL)


@pytest.mark.slow
def test_a_change_on_the_server_is_found_although_the_copy_is_good(bucket: Any, runs: Path, tmp_path: Path) -> None:
    run = pushed(runs)[1]
    assert planrunner("verify", "--all", _URL, cwd=tmp_path).returncode == 0
    path = next(path for path in bucket.find(f"laboratory/archive/{run.name}/segments"))
    data = bytearray(bucket.cat_file(path))
    data[len(data) // 2] ^= 1
    bucket.pipe_file(path, bytes(data))
    done = planrunner("verify", "--all", _URL, cwd=tmp_path)
    assert done.returncode == 4 and f"{_RUNS} runs: 1 changed" in done.stdout


@pytest.mark.slow
def test_a_removed_file_is_removed_from_the_copy(bucket: Any, runs: Path, tmp_path: Path) -> None:
    run = pushed(runs)[1]
    fetched(_URL)
    bucket.rm(f"laboratory/archive/{run.name}/plan.yaml")
    assert planrunner("verify", "--all", _URL, cwd=tmp_path).returncode == 4


@pytest.mark.slow
def test_an_analysis_of_a_remote_run_is_written_there(bucket: Any, runs: Path, tmp_path: Path) -> None:
    run = pushed(runs)[0]
    before = len(bucket.find(f"laboratory/archive/{run.name}/analyses"))
    done = planrunner("estimate", f"{_URL}/{run.name}", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(bucket.find(f"laboratory/archive/{run.name}/analyses")) == 2 * before
    number = json.loads(done.stdout)[0]["analysis"].rpartition("/")[2]
    assert bucket.exists(f"laboratory/archive/{run.name}/analyses/{number}/results.json")


@pytest.mark.slow
def test_commands_read_a_remote_archive(bucket: Any, runs: Path, tmp_path: Path) -> None:
    pushed(runs)
    index = tmp_path / "index.sqlite"
    listed = planrunner("runs", _URL, "--index", index, "--json", cwd=tmp_path)
    assert listed.returncode == 0 and json.loads(listed.stdout)["total"] == _RUNS, listed.stderr
    assert planrunner("runs", _URL, "--index", index, "--rebuild", cwd=tmp_path).returncode == 0
    pulled = planrunner("archive", "pull", _URL, "here", cwd=tmp_path)
    assert pulled.returncode == 0 and f"{_RUNS} runs copied and verified, 0 existed already" in pulled.stdout
    assert sorted(path.name for path in (tmp_path / "here").iterdir()) == sorted(path.name for path in runs.iterdir())
    again = planrunner("archive", "pull", _URL, "here", "--json", cwd=tmp_path)
    assert json.loads(again.stdout) == {"pulled": [], "present": _RUNS}


@pytest.mark.slow
def test_push_by_command(bucket: Any, runs: Path, tmp_path: Path) -> None:
    done = planrunner("archive", "push", "--all", runs, _URL, cwd=tmp_path)
    assert done.returncode == 0 and done.stdout.count("files written, 0 existed already") == _RUNS, done.stderr


def test_an_archive_that_is_not_there_is_a_message(bucket: Any) -> None:
    assert refusal(fetched, "s3://laboratory/nothing").startswith("remote-unreachable: ")
    assert refusal(fetched, "nonsense://a/b").startswith("remote-unreachable: ")


def test_a_folder_outside_the_copies_has_no_source(tmp_path: Path) -> None:
    assert source_of_copy(tmp_path) is None


_POSITIONS = """\
planrunner: 1
title: Drift in eight positions
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
record: {device_serial: required, operator: required}
defaults: {temperature: 25 degC, settle: 1 s, dwell: 10 s}
segments:
  - for_each:
      orientation:
        P1: {x: up, y: north, z: west}
        P2: {x: down, y: north, z: east}
        P3: {x: north, y: up, z: east}
        P4: {x: north, y: down, z: west}
        P5: {x: east, y: south, z: down}
        P6: {x: south, y: east, z: up}
        P7: {x: west, y: south, z: up}
        P8: {x: south, y: west, z: down}
estimates:
  drift: {estimator: flexure_gyro_static, segments: P*}
"""


@pytest.mark.slow
def test_histories_studies_and_sites_of_a_remote_archive_are_those_of_the_folder(bucket: Any, tmp_path: Path) -> None:
    """Two runs of each of two devices by each of two operators. Then somebody changes a file on the server."""
    local = tmp_path / "runs"
    sound = check_plan(Document(_POSITIONS.encode(), "positions.yaml")).sound()
    for number, (device, operator, _) in enumerate(product(("D1", "D2"), ("ann", "bob"), range(2))):
        info = {"device_serial": device, "operator": operator}
        run, outcome = running.start(
            sound, info=info, runs=local, stop=StopRequest(), durability="flushed", seed=number
        )
        assert outcome.ok
        analyse_run(run)
        push_run(run, _URL)
    first, second = sorted(local.iterdir())[:2]
    same: list[tuple[str, ...]] = [
        ("history", "D1", "drift.D_X_F", "--json", "--runs", "ARCHIVE"),
        ("gauge", "drift.D_X_F", "--json", "--runs", "ARCHIVE"),
        ("compare", f"ARCHIVE/{first.name}", f"ARCHIVE/{second.name}", "--json"),
    ]
    for words in same:
        answers = [
            planrunner(
                *(word.replace("ARCHIVE", place) for word in words),
                cwd=tmp_path,
                PLANRUNNER_INDEX=str(tmp_path / f"{name}.sqlite"),
            )
            for name, place in (("here", str(local)), ("there", _URL))
        ]
        assert answers[0].returncode == answers[1].returncode in (0, 1), answers[1].stderr
        texts = [
            answer.stdout.replace(place, "ARCHIVE") for answer, place in zip(answers, (str(local), _URL), strict=True)
        ]
        assert texts[0] and texts[0] == texts[1]
    for name, place in (("here", str(local)), ("there", _URL)):
        done = planrunner(
            "site", place, f"site-{name}", "--index", tmp_path / f"{name}.sqlite", "--quiet", cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
    here, there = (
        {path.name: path.read_bytes() for path in tmp_path.glob(f"site-{name}/data-*/*.js")}
        for name in ("here", "there")
    )
    assert here and here == there
    bucket.pipe(f"laboratory/archive/{first.name}/plan.yaml", b"changed")
    damaged = planrunner(
        "history", "D1", "drift.D_X_F", "--runs", _URL, "--index", tmp_path / "there.sqlite", cwd=tmp_path
    )
    assert damaged.returncode == 4 and first.name in damaged.stderr


@pytest.mark.slow
def test_a_report_of_a_remote_run_is_written_there(bucket: Any, runs: Path, tmp_path: Path) -> None:
    run = pushed(runs)[0]
    before = set(bucket.find(f"laboratory/archive/{run.name}/analyses"))
    done = planrunner("report", f"{_URL}/{run.name}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    new = set(bucket.find(f"laboratory/archive/{run.name}/analyses")) - before
    assert any(name.endswith("summary.md") for name in new), (done.stdout, new)
