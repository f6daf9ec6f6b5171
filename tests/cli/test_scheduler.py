"""`--scheduler`: commands on a Dask cluster of processes print and write what they do on one process."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from planrunner.execution.stopping import StopRequest
from planrunner.tasks import run as running
from planrunner.tasks.check import check_plan
from tests.conftest import ROOT
from tests.dask_cluster import Cluster, dask_cluster
from tests.in_process import planrunner

pytest.importorskip("distributed")

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


def test_an_address_of_another_form_is_refused(tmp_path: Path) -> None:
    done = planrunner("verify", "runs", "--scheduler", "localhost", cwd=tmp_path)
    assert done.returncode == 2 and "tcp://" in done.stderr


def test_processes_and_a_cluster_exclude_each_other(tmp_path: Path) -> None:
    done = planrunner("verify", "runs", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2", cwd=tmp_path)
    assert done.returncode == 2 and "give --jobs or --scheduler" in done.stderr


def test_one_run_is_not_diagnosed_on_a_cluster(tmp_path: Path) -> None:
    done = planrunner("diagnose", "run", "--scheduler", "tcp://127.0.0.1:1", cwd=tmp_path)
    assert done.returncode == 2 and "--scheduler is for several runs" in done.stderr
