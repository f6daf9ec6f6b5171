"""A disk that fills up in the middle of a run, and while results are written: nothing is lost, and there is a way on."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from planrunner.archive.run_folder import RunWriter
from planrunner.instruments.interfaces import SummaryChannels
from planrunner.plan.schedule import Segment
from tests import in_process

FLAGSHIP = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
GIVEN = ["--set", "device_serial=1", "--set", "operator=test", "--quiet"]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("only root on Linux can mount a small disk")
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400m", "none", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {mounted.stderr.decode().strip()}")
    yield folder
    for _ in range(
        100
    ):  # a process that was killed, or an error that waits for collection, may hold a file a moment longer
        gc.collect()
        if subprocess.run(["umount", folder], capture_output=True).returncode == 0:
            return
        time.sleep(0.1)
    subprocess.run(["umount", "--lazy", folder], check=True)
    pytest.fail(f"{folder} is still in use")


def remount(disk: Path, option: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{option}", disk], check=True)


def planrunner(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    done = in_process.planrunner(*arguments, cwd=cwd)
    assert "internal error" not in done.stderr
    return done


def fill_up_during_a_run(plan: Path, disk: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Path]:
    """Standard error of a run whose disk shrinks to what is in use before its fifth segment, and its folder."""
    begin = RunWriter.begin

    def shrunk(
        self: RunWriter,
        segment: Segment,
        clock: float,
        channels: Mapping[str, str],
        summary: SummaryChannels | None = None,
    ) -> None:
        if segment.index == 4:
            remount(disk, f"size={shutil.disk_usage(disk).used + 3 * 2**20}")
        begin(self, segment, clock, channels, summary)

    with monkeypatch.context() as patch:
        patch.setattr(RunWriter, "begin", shrunk)
        done = planrunner("run", plan, *GIVEN, "--runs", disk / "runs", cwd=disk.parent)
    assert done.returncode == 3, done.stderr
    (run,) = disk.glob("runs/2*")
    return done.stderr, run


def test_a_run_goes_on_after_the_disk_was_full(
    disk: Path, tmp_path: Path, plan_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_file(("dwell: 2 min", "dwell: 30 min"))
    whole = planrunner("run", plan, *GIVEN, "--runs", "whole", cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    (expected,) = (tmp_path / "whole").glob("2*/analyses/1/results.json")

    said, run = fill_up_during_a_run(plan, disk, monkeypatch)
    assert "No space left on device" in said
    assert f"planrunner resume {run}" in said
    still = planrunner("resume", run, "--quiet", cwd=tmp_path)
    assert still.returncode in (2, 3)
    assert "No space left on device" in still.stderr
    remount(disk, "size=400m")
    resumed = planrunner("resume", run, "--quiet", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert (run / "analyses" / "1" / "results.json").read_bytes() == expected.read_bytes()

    results_on_a_full_disk(run, disk, plan)
    remount(disk, "ro")
    for command in (
        ["estimate", run],
        ["resume", run],
        ["run", FLAGSHIP, *GIVEN],
        ["new", "flexure_gyro_eight_position"],
    ):
        done = planrunner(*command, cwd=disk)
        assert done.returncode == 2, command
        assert "Read-only file system" in done.stderr, command
    assert planrunner("check", plan, cwd=disk).returncode == 0


def results_on_a_full_disk(run: Path, disk: Path, plan: Path) -> None:
    """No half-written analysis, report, export, page or copy of a plan; each message names the file."""
    with (disk / "filler").open("wb", buffering=0) as filler:
        while shutil.disk_usage(disk).free:
            filler.write(bytes(shutil.disk_usage(disk).free))
    standing = sorted(path.name for path in (run / "analyses").iterdir())
    commands = (
        (["estimate", run], run / "analyses"),
        (["report", run], run / "analyses"),
        (["export", run, "--output", disk / "x.csv"], disk / "x.csv"),
        (["show", plan, "--html", disk / "s.html"], disk / "s.html"),
        (["new", "flexure_gyro_eight_position", disk / "n.yaml"], disk / "n.yaml"),
    )
    for command, target in commands:
        done = planrunner(*command, cwd=disk)
        assert done.returncode == 2, command
        assert f"{target}:" in done.stderr, command
        assert "No space left on device" in done.stderr, command
    assert sorted(path.name for path in (run / "analyses").iterdir()) == standing
    assert sorted(path.name for path in disk.iterdir()) == ["filler", "runs"]
    (disk / "filler").unlink()


def test_too_little_space_is_reported_before_anything_moves(
    disk: Path, tmp_path: Path, plan_file: Callable[..., Path]
) -> None:
    remount(disk, "size=2m")
    done = planrunner("run", plan_file(), *GIVEN, "--runs", disk / "runs", cwd=tmp_path)
    assert done.returncode == 2
    assert "error[disk-space]: the run needs up to" in done.stderr
    assert not list(disk.iterdir())
