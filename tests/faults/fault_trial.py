"""One trial: a run into which something goes wrong, what is left, and the same run resumed on instruments that are well again."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from fault_judging import acknowledged, begun, check_complete, check_kept, events, not_safe, run_folder
from fault_table import MOVING, START, TURNING, WARMING, Row
from forked_runs import Run
from small_bench import AMBIENT, PATIENCE, SmallBench, until

RUN = ("run", "plan.yaml", "--quiet", "--flushed")


@dataclass
class Ended:
    """How the faulty run ended. not_safe: instruments by what is true of them; kept: label → digests of what was acknowledged."""

    code: int
    said: str
    folder: Path | None
    not_safe: tuple[str, ...]
    kept: dict[str, tuple[str, ...]]
    notices: list[str] = field(default_factory=list)


def scripted(bench: SmallBench, row: Row) -> None:
    """Raises `AssertionError` where it does not end as the row says."""
    older = run_folder(bench)
    strike(bench, row.fault, None) if row.when == START else None
    run = bench.planrunner(*RUN)
    if row.when != START:
        until(lambda: run.code is not None or _has_come(bench, row.when, older), f"{row.when} begins")
        assert run.code is None, run.said
        strike(bench, row.fault, run)
    ended = finished(bench, run, older, killed=row.ends < 0)
    assert ended.code == row.ends, ended.said
    assert row.says in ended.said and "Traceback" not in ended.said, ended.said
    assert set(ended.not_safe) <= set(row.not_safe), f"not safe: {ended.not_safe}; {ended.said}"
    for name in ended.not_safe:
        assert f"NOT IN THE SAFE STATE: {name}" in ended.said or f"{name}: NOT SAFE" in ended.said, ended.said
    assert len(ended.kept) >= row.kept, ended.kept
    assert any(row.notices in text for text in ended.notices) or not row.notices, ended.notices
    resumed(bench, ended)


def strike(bench: SmallBench, fault: str, run: Run | None) -> None:
    """Let it go wrong."""
    if fault.startswith("{"):
        bench.inject(fault)
    elif fault == "SIGKILL simulator":
        bench.process.kill()
        bench.process.wait()
    elif fault == "SIGKILL watchdog":
        assert run is not None
        os.kill(_watchdog_of(run), signal.SIGKILL)
    elif fault.startswith("SIG"):
        assert run is not None
        run.send(getattr(signal, fault))
    else:
        (bench.folder / fault.replace(" ", "-")).touch()


def finished(bench: SmallBench, run: Run, older: Path | None, killed: bool) -> Ended:
    """Wait for the end of a run, and of its watchdog where that has to act."""
    folder: Callable[[], Path | None] = lambda: None if run_folder(bench) == older else run_folder(bench)  # noqa: E731
    if killed:
        until(lambda: (place := folder()) is None or (place / "watchdog.txt").exists(), "the watchdog reports")
    code = run.wait(PATIENCE)
    said, place = run.said, folder()
    if place is not None and (place / "watchdog.txt").exists():
        said += (place / "watchdog.txt").read_text(encoding="utf-8")
    notices = [event["text"] for event in events(place) if event["event"] == "noticed"]
    return Ended(code, said, place, _not_safe(bench), acknowledged(place), notices)


def resumed(bench: SmallBench, ended: Ended) -> None:
    """Everything is well again: the run goes on to its end, and has all that it had."""
    for name in ("disk-full", "clock-step", "clock-leap"):
        (bench.folder / name).unlink(missing_ok=True)
    if bench.process.poll() is None:
        bench.clear()
    else:
        bench.start_again()
    if ended.code != 0:
        again = RUN if ended.folder is None else ("resume", str(ended.folder), "--quiet")
        run = bench.planrunner(*again)
        assert run.wait(PATIENCE) == 0, run.said
        assert not_safe(bench) == (), run.said
    folder = run_folder(bench) if ended.folder is None else ended.folder
    assert folder is not None
    check_kept(folder, ended.kept)
    check_complete(folder, bench.sensor)


def _not_safe(bench: SmallBench) -> tuple[str, ...]:
    return not_safe(bench) if bench.process.poll() is None else ("table", "chamber")


def _has_come(bench: SmallBench, when: str, older: Path | None) -> bool:
    folder = run_folder(bench)
    if folder is None or folder == older:
        return False
    if when == MOVING:
        return begun(folder, "still")
    if when == TURNING:
        return begun(folder, "turning") and abs(bench.state()["table"]["rates"][0]) > 0.17 and _records(folder)
    return when == WARMING and begun(folder, "warm") and bench.state()["chamber"]["target"] > AMBIENT + 1


def _records(folder: Path) -> bool:
    return len(acknowledged(folder)) == 1


def _watchdog_of(run: Run) -> int:
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and f"PPid:\t{run.pid}\n" in (entry / "status").read_text(encoding="utf-8"):
                return int(entry.name)
        except OSError:
            continue
    raise AssertionError("the run has no watchdog")
