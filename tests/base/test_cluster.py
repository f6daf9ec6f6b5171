"""Work on a Dask cluster of processes: the results are those of one process, also if a worker is lost on the way."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from planrunner.base import cluster as on_cluster
from planrunner.base.findings import InputError
from planrunner.base.processes import ProcessEndedError
from planrunner.base.workers import ALONE, Workers, results_in_order, results_of
from tests.conftest import ROOT
from tests.dask_cluster import Cluster, dask_cluster

pytest.importorskip("distributed")


def drawn(seed: int, item: int) -> bytes:
    """Numbers that depend on every bit of what comes before them."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(item,)))
    matrix = rng.standard_normal((40, 40))
    return np.linalg.inv(matrix @ matrix.T).tobytes()


def marked(folder: Path, item: int) -> tuple[int, bytes]:
    """Leaves a file with the process that computes the item, and takes a moment."""
    (folder / f"{item}-{os.getpid()}").touch()
    time.sleep(0.1)
    return item, drawn(7, item)


def name_of(path: Path) -> str:
    return path.name


def fails(item: int) -> int:
    if item >= 5:
        raise ArithmeticError(f"of {item}")
    return item


def ends(item: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return item


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with dask_cluster(tmp_path_factory.mktemp("cluster")) as found:
        yield found


def on(cluster: Cluster) -> Workers:
    return Workers(1, cluster.address)


def refusal(address: str) -> str:
    with pytest.raises(InputError) as refused:
        results_of(fails, range(3), Workers(1, address))
    (found,) = refused.value.findings
    assert found.hint
    return f"{found.code}: {found.message}"


@pytest.mark.slow
def test_results_are_those_of_one_process_to_the_last_digit(cluster: Cluster) -> None:
    shares: list[float] = []
    found = results_of(partial(drawn, 3), range(60), on(cluster), shares.append)
    assert found == results_of(partial(drawn, 3), range(60), ALONE)
    assert shares == sorted(shares) and shares[-1] == 1.0


@pytest.mark.slow
def test_the_first_failure_is_raised_after_the_results_before_it(cluster: Cluster) -> None:
    found = results_in_order(fails, range(20), on(cluster))
    assert [next(found) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(ArithmeticError, match="of 5"):
        next(found)


@pytest.mark.slow
def test_a_folder_that_a_worker_does_not_see_is_a_message(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert results_of(name_of, [tmp_path, tmp_path / "absent"], on(cluster)) == [tmp_path.name, "absent"]
    monkeypatch.setattr(on_cluster, "_paths", lambda items: (str(tmp_path / "only here"),))
    with pytest.raises(InputError, match="only here"):
        results_of(name_of, [tmp_path], on(cluster))


@pytest.mark.parametrize("items", [[Path("runs/a")], [Path("runs/a"), Path("runs/b")], [(Path("runs/b"), "bench")]])
def test_a_worker_never_computes_on_its_own_folder_of_the_same_name(
    items: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder of the command has all runs. The worker has no such folder, or one without run b; its own folder has all runs too."""
    for place in ("command", "worker"):
        for run in "ab":
            (tmp_path / place / "runs" / run).mkdir(parents=True)
    shared = tmp_path / "shared"
    (shared / "runs" / "a").mkdir(parents=True)
    monkeypatch.setattr(on_cluster, "_name", lambda: "worker 1")
    monkeypatch.chdir(tmp_path / "command")
    paths = on_cluster._paths(items)
    assert paths == tuple(str(item[0] if isinstance(item, tuple) else item) for item in items)
    monkeypatch.chdir(tmp_path / "worker")
    work = on_cluster._packed(str)
    absent = on_cluster._Terms(on_cluster.versions(), str(tmp_path / "absent"))
    assert on_cluster._compute(work, absent, items, paths).unseen == paths[0]
    partly = on_cluster._Terms(on_cluster.versions(), str(shared))
    unseen = on_cluster._compute(work, partly, items, paths).unseen
    assert unseen == ("runs/b" if "runs/b" in paths else "")
    assert on_cluster._compute(work, absent, [1, 2]).results == ("1", "2")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_a_worker_that_is_killed_on_the_way_loses_nothing(tmp_path: Path) -> None:
    with dask_cluster(tmp_path) as cluster:
        folder = tmp_path / "marks"
        folder.mkdir()
        found: list[tuple[int, bytes]] = []
        victim = cluster.workers[0]
        for result in results_in_order(partial(marked, folder), range(40), on(cluster)):
            found.append(result)
            if len(found) == 10:
                while not any(path.name.endswith(f"-{victim.pid}") for path in folder.iterdir()):
                    time.sleep(0.01)
                os.kill(victim.pid, signal.SIGKILL)
    assert found == [(item, drawn(7, item)) for item in range(40)]
    assert victim.poll() == -signal.SIGKILL
    after = [path.name.split("-") for path in folder.iterdir()]
    assert {pid for _, pid in after} == {str(worker.pid) for worker in cluster.workers}
    repeated = len(after) - len({item for item, _ in after})
    assert {item for item, _ in after} == {str(item) for item in range(40)} and repeated >= 1


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_work_that_ends_every_worker_is_an_error(tmp_path: Path) -> None:
    with (
        dask_cluster(tmp_path, 2, allowed_failures=1) as cluster,
        pytest.raises(ProcessEndedError, match="workers ended"),
    ):
        results_of(ends, range(1), on(cluster))


@pytest.mark.slow
def test_a_worker_with_another_version_is_a_message(tmp_path: Path) -> None:
    """Its planrunner is the same but for one comment in the source."""
    other = tmp_path / "other"
    shutil.copytree(ROOT / "planrunner", other / "planrunner", ignore=shutil.ignore_patterns("__pycache__"))
    with (other / "planrunner" / "base" / "workers.py").open("a") as file:
        file.write("# changed\n")
    with dask_cluster(tmp_path, workers=0) as cluster:
        cluster.add_worker({"PYTHONPATH": os.pathsep.join([str(other), *sys.path])})
        said = refusal(cluster.address)
    assert said.startswith("scheduler-versions: ") and "planrunner 0." in said and "instead of" in said


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_a_scheduler_that_ends_is_an_error(tmp_path: Path) -> None:
    with dask_cluster(tmp_path, workers=1) as cluster:
        folder = tmp_path / "marks"
        folder.mkdir()
        found = results_in_order(partial(marked, folder), range(60), on(cluster))
        next(found)
        cluster.scheduler.kill()
        with pytest.raises(ProcessEndedError, match="scheduler"):
            list(found)


def test_a_scheduler_that_does_not_answer_is_a_message() -> None:
    with socket.socket() as taken:  # bound without listening, so that nobody else can take it
        taken.bind(("127.0.0.1", 0))
        said = refusal(f"tcp://127.0.0.1:{taken.getsockname()[1]}")
    assert said.startswith("scheduler-unreachable: no Dask scheduler answers at tcp://127.0.0.1:")


def test_without_dask_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert refusal("tcp://127.0.0.1:1") == "scheduler-missing: Dask is not installed"


def test_this_process_alone_needs_no_dask() -> None:
    code = "import sys; from planrunner.base.workers import *; print(results_of(abs, [-1, 2], ALONE), 'distributed' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == "[1, 2] False"


@pytest.mark.parametrize("workers", [ALONE, Workers(2), Workers()])
def test_results_come_in_order_with_progress(workers: Workers) -> None:
    shares: list[float] = []
    assert list(results_in_order(abs, range(-200, 0), workers, shares.append)) == list(range(200, 0, -1))
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_what_is_sent_to_workers_can_be_pickled() -> None:
    assert pickle.loads(pickle.dumps(ALONE)) == ALONE
