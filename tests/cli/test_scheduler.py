"""`--scheduler`: commands on a Dask cluster of processes print and write what they do on one process."""

from __future__ import annotations

import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from planrunner.base.workers import ALONE, Workers
from planrunner.design.study import Asked
from planrunner.execution.stopping import StopRequest
from planrunner.signing.keys import PrivateKey, write_unencrypted
from planrunner.tasks import run as running
from planrunner.tasks.check import check_plan
from planrunner.tasks.design import design
from planrunner.tasks.estimate import evaluate_run
from tests.conftest import ROOT
from tests.dask_cluster import Cluster, dask_cluster
from tests.in_process import planrunner

pytest.importorskip("distributed")
cloudpickle = pytest.importorskip("cloudpickle")

_PLAN = ROOT / "tests" / "agreement" / "corpus" / "counts_that_alternate.yaml"
_RUNS = 6


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one plan with different random numbers."""
    folder = tmp_path_factory.mktemp("archive") / "runs"
    sound = check_plan(_PLAN).sound()
    for seed in range(_RUNS):
        _, outcome = running.start(sound, info={}, runs=folder, stop=StopRequest(), durability="flushed", seed=seed)
        assert outcome.ok
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with dask_cluster(tmp_path_factory.mktemp("cluster")) as found:
        yield found


def contents(archive: Path) -> dict[str, bytes]:
    """Every file of the analyses, without the time at which they were made."""
    found = {}
    for path in sorted(archive.rglob("analyses/**/*")):
        if path.is_file() and path.name != "digests.json":
            found[str(path.relative_to(archive))] = re.sub(rb"Analysed \(UTC\): \S+", b"", path.read_bytes())
    return found


@pytest.mark.slow
def test_an_archive_is_estimated_to_the_last_digit_as_by_one_process(
    archive: Path, cluster: Cluster, tmp_path: Path
) -> None:
    found = {}
    for name, options in {"here": (), "cluster": ("--scheduler", cluster.address), "forks": ("--jobs", "2")}.items():
        shutil.copytree(archive, tmp_path / name / "runs")
        done = planrunner("estimate", "--all", "runs", "--json", *options, cwd=tmp_path / name)
        found[name] = done.returncode, done.stdout, contents(tmp_path / name / "runs")
    assert found["here"] == found["cluster"] == found["forks"]
    assert len(json.loads(found["here"][1])) == _RUNS
    assert len({data for name, data in found["here"][2].items() if name.endswith("results.json")}) == _RUNS


@pytest.mark.slow
def test_verification_finds_the_same_change(archive: Path, cluster: Cluster, tmp_path: Path) -> None:
    shutil.copytree(archive, tmp_path / "runs")
    victim = sorted((tmp_path / "runs").glob("*/segments/*"))[3]
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 1
    victim.write_bytes(data)
    here = planrunner("verify", "--all", "runs", cwd=tmp_path)
    there = planrunner("verify", "--all", "runs", "--scheduler", cluster.address, cwd=tmp_path)
    assert here.returncode == there.returncode == 4
    assert here.stdout == there.stdout and f"{_RUNS} runs: 1 changed" in there.stdout


@pytest.mark.slow
def test_checks_of_plans_give_the_same_findings(cluster: Cluster) -> None:
    plans = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "plans").glob("flexure*.yaml"))
    here, there = (
        planrunner("check", "--json", *plans, *options, cwd=ROOT) for options in ((), ("--scheduler", cluster.address))
    )
    assert (here.returncode, here.stdout) == (there.returncode, there.stdout)


@pytest.mark.slow
def test_a_search_for_positions_finds_the_same_digits(cluster: Cluster) -> None:
    words = ("design", "plans/flexure_gyro_eight_position.yaml", "--json", "--quiet", "--restarts", "4")
    here, forks, there = (
        planrunner(*words, *options, cwd=ROOT) for options in ((), ("--jobs", "2"), ("--scheduler", cluster.address))
    )
    assert here.returncode == 0 and json.loads(here.stdout)
    assert here.stdout == there.stdout == forks.stdout, there.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_monte_carlo_draws_the_same_numbers_though_a_worker_is_lost(tmp_path: Path) -> None:
    """The plan has its intervals validated by Monte Carlo, with draws that a worker makes."""
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    plan = plan.replace("segments: P*, ", "segments: P*, validate: {digits: 1, draws: 100000, seed: 1}, ")
    plan = plan.replace("dwell: 2 min", "dwell: 10 s").replace("[report.html, summary.md]", "[summary.md]")
    (tmp_path / "validated.yaml").write_text(plan, encoding="utf-8")
    sound = check_plan(tmp_path / "validated.yaml").sound()
    for seed in range(4):
        info = {"device_serial": str(seed), "operator": "ann"}
        _, outcome = running.start(
            sound, info=info, runs=tmp_path / "here" / "runs", stop=StopRequest(), durability="flushed", seed=seed
        )
        assert outcome.ok
    shutil.copytree(tmp_path / "here", tmp_path / "there")
    here = planrunner("estimate", "--all", "runs", cwd=tmp_path / "here")
    with dask_cluster(tmp_path, allowed_failures=5) as cluster:
        words = ("-m", "planrunner", "estimate", "--all", "runs", "--scheduler", cluster.address)
        with subprocess.Popen(
            (sys.executable, *words), cwd=tmp_path / "there", stdout=subprocess.PIPE, text=True
        ) as there:
            assert there.stdout is not None
            lines = [there.stdout.readline()]  # the name of the first run, which has been computed
            victim = cluster.workers[0]
            os.kill(victim.pid, signal.SIGKILL)
            lines += there.stdout.readlines()
    assert victim.returncode == -signal.SIGKILL and there.returncode == here.returncode
    assert "".join(lines) == here.stdout and here.stdout.count("Monte Carlo draws") == 4
    assert contents(tmp_path / "there" / "runs") == contents(tmp_path / "here" / "runs")


def lost(cluster: Cluster, work: Callable[[Workers], Any]) -> Any:
    """The result of the work on the cluster. Its only worker is killed as soon as it has begun to compute; then another one joins."""
    victim = cluster.workers[-1]

    def used() -> int:
        """Processor time, in hundredths of a second."""
        return int(Path(f"/proc/{victim.pid}/stat").read_text().rpartition(")")[2].split()[11])

    begun, ended = used(), threading.Event()

    def kill() -> None:
        while not ended.wait(0.01):
            if used() > begun + 3:
                os.kill(victim.pid, signal.SIGKILL)
                cluster.add_worker()
                return

    killing = threading.Thread(target=kill)
    killing.start()
    try:
        found = work(Workers(1, cluster.address))
    finally:
        ended.set()
        killing.join()
    assert victim.wait(60) == -signal.SIGKILL
    return found


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the processor time of a worker is read from /proc")
def test_draws_of_one_run_and_searches_find_the_same_digits_though_workers_are_lost(tmp_path: Path) -> None:
    plans = ROOT / "plans"
    plan = (plans / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    plan = plan.replace("segments: P*, ", "segments: P*, validate: {digits: 2, draws: 250000, seed: 1}, ")
    plan = plan.replace("dwell: 2 min", "dwell: 10 s").replace("[report.html, summary.md]", "[summary.md]")
    (tmp_path / "validated.yaml").write_text(plan, encoding="utf-8")
    sound = check_plan(tmp_path / "validated.yaml").sound()
    run, outcome = running.start(
        sound, info={}, runs=tmp_path / "runs", stop=StopRequest(), durability="flushed", seed=1
    )
    assert outcome.ok

    def draws(workers: Workers) -> object:
        results = evaluate_run(run, workers=workers).results.to_json()
        assert "250000" in json.dumps(results)
        return results

    def rates(workers: Workers) -> object:
        return design(plans / "scale_factor_tilted.yaml", Asked(rates=True), workers=workers).data

    def cycle(workers: Workers) -> object:
        return design(plans / "rotation_stop_navigation.yaml", Asked(segment="printed"), workers=workers).data

    with dask_cluster(tmp_path, workers=1, allowed_failures=5) as cluster:
        for work in (draws, rates, cycle):
            here = work(ALONE)
            assert here == lost(cluster, work), work.__name__
    refused = planrunner("estimate", str(run), "--scheduler", "tcp://127.0.0.1:1", cwd=tmp_path)
    assert refused.returncode == 2 and "scheduler-unreachable" in refused.stderr
    assert not list(run.glob("analyses/*"))  # a failure of the cluster is no failed estimate


@pytest.mark.slow
def test_an_index_is_rebuilt_as_by_one_process(archive: Path, cluster: Cluster, tmp_path: Path) -> None:
    shutil.copytree(archive, tmp_path / "runs")
    damaged = next((tmp_path / "runs").glob("*/run.json"))
    damaged.write_bytes(damaged.read_bytes()[1:])
    found = []
    for number, options in enumerate(((), ("--scheduler", cluster.address), ("--jobs", "2"))):
        words = (
            "runs",
            "runs",
            "--rebuild",
            "--json",
            "--index",
            f"{number}.sqlite",
            "--export",
            f"{number}",
            "--quiet",
        )
        done = planrunner(*words, *options, cwd=tmp_path)
        tables = {path.name: path.read_bytes() for path in sorted((tmp_path / f"{number}").iterdir())}
        found.append((done.returncode, done.stdout, tables))
    assert found[0] == found[1] == found[2]
    assert found[0][0] == 4 and json.loads(found[0][1])["total"] == _RUNS - 1


def test_an_address_of_another_form_is_refused(tmp_path: Path) -> None:
    done = planrunner("verify", "runs", "--scheduler", "localhost", cwd=tmp_path)
    assert done.returncode == 2 and "tcp://" in done.stderr


def test_processes_and_a_cluster_exclude_each_other(tmp_path: Path) -> None:
    done = planrunner("verify", "runs", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2", cwd=tmp_path)
    assert done.returncode == 2 and "give --jobs or --scheduler" in done.stderr


def test_one_run_is_not_diagnosed_on_a_cluster(tmp_path: Path) -> None:
    done = planrunner("diagnose", "run", "--scheduler", "tcp://127.0.0.1:1", cwd=tmp_path)
    assert done.returncode == 2 and "--scheduler is for several runs" in done.stderr


_STANDARD = "check_standard: {device: C, plan: c.yaml, coefficients: {drift.D_X_F: {}}, max_age: 1 h, action: warn}\n"


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The answers of a cluster that sees the plans, but has no signing keys, and a clock that is never asked."""
    answers: list[object] = []
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    monkeypatch.setenv("PLANRUNNER_STATE", str(tmp_path / "state"))
    key = PrivateKey(Ed25519PrivateKey.from_private_bytes(bytes([11]) * 32))
    (tmp_path / "state" / "signing-keys").mkdir(parents=True)
    (tmp_path / "state").chmod(0o700)
    write_unencrypted(tmp_path / "state" / "signing-keys" / "lab.pem", key)
    (tmp_path / "state" / "signing-keys" / "lab.pem.pub").write_text(f"{key.public.line} lab\n")
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    for name, more in {"signed": f"signing: {{key: {key.public.line}}}\n", "plain": "", "watched": _STANDARD}.items():
        (tmp_path / f"bench_{name}.yaml").write_text(bench + more)
        (tmp_path / f"{name}.yaml").write_text(re.sub("(?m)^bench: .*", f"bench: bench_{name}.yaml", plan))

    def computed(work: Callable[[Any], Any], items: Sequence[Any], *_: object) -> Iterator[Any]:
        work = pickle.loads(cloudpickle.dumps(work))
        for item in items:
            keys = mock.patch.dict(os.environ, PLANRUNNER_STATE=str(tmp_path / "worker"))
            with keys, mock.patch("planrunner.tasks.check.date", None):
                answers.append(work(item))
            yield answers[-1]

    monkeypatch.setattr("planrunner.base.cluster.computed_on_cluster", computed)
    return answers


@pytest.mark.parametrize("file", ["plans", "suite"])
def test_what_belongs_to_this_computer_is_checked_here(file: str, elsewhere: list[object], tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(
        "planrunner_suite: 1\ntitle: Two\nbenches: {s: {bench: bench_signed.yaml}, p: {bench: bench_plain.yaml}}\n"
        "devices: {FG-7: {benches: s}, FG-8: {benches: p}}\nset: {operator: ann, device_serial: X}\n"
        "plans: {a: {plan: signed.yaml, devices: FG-7}, b: {plan: plain.yaml, devices: FG-8}}\n"
    )
    words = ("signed.yaml", "plain.yaml", "watched.yaml") if file == "plans" else ("suite.yaml",)
    here, there = (
        planrunner("check", *words, *options, cwd=tmp_path) for options in ((), ("--scheduler", "tcp://127.0.0.1:1"))
    )
    assert here.returncode == 0, here.stdout + here.stderr
    assert (here.returncode, here.stdout, here.stderr) == (there.returncode, there.stdout, there.stderr)
    decided = [one is not None for one in elsewhere]
    assert decided == ([False, True, False] if file == "plans" else [False, False, True])
