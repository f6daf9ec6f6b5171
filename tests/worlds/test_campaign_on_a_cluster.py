"""A campaign of simulated worlds has the same figures on a Dask cluster of processes as in one process, though a worker is lost."""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from pathlib import Path

import pytest

from planrunner.base.workers import ALONE, Workers, results_in_order
from tests.dask_cluster import dask_cluster
from tests.worlds.__main__ import main
from tests.worlds.coverage import Batch, tally_of

pytest.importorskip("distributed")

ESTIMATOR, WORLD = "flexure_gyro_static", "white noise"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_figures_do_not_depend_on_the_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    batches = [Batch(ESTIMATOR, WORLD, 4, first) for first in range(0, 40, 4)]
    alone = list(results_in_order(partial(tally_of, 5), batches, ALONE))
    assert len({str(one) for one in alone}) == len(batches)
    words = ["--runs", "30", "--estimator", ESTIMATOR, "--world", WORLD, "--keep"]
    main([*words, str(tmp_path / "alone")])
    with dask_cluster(tmp_path) as cluster:
        main([*words, str(tmp_path / "cluster"), "--scheduler", cluster.address])
        tables = capsys.readouterr().out.split("| estimator |")[1:]
        found = []
        for one in results_in_order(partial(tally_of, 5), batches, Workers(1, cluster.address)):
            found.append(one)
            if len(found) == 2:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)
        assert cluster.workers[0].wait() == -signal.SIGKILL and cluster.workers[1].poll() is None
    assert found == alone
    assert tables[0] == tables[1] and "| 30 |" in tables[0]
    assert (tmp_path / "alone").read_bytes() == (tmp_path / "cluster").read_bytes()
