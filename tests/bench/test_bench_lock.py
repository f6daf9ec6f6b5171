"""One run a bench: what is locked, who is told, and that locks come back. Across processes: tests/lab."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from planrunner import plugins
from planrunner.bench import lock
from planrunner.bench.lock import bench_lock
from planrunner.bench.model import Bench, parse_bench, real_instruments
from planrunner.exclusive import ExclusiveFile, HeldError
from planrunner.plan import source
from planrunner.plan.findings import InputError
from planrunner.plan.kinds import Record, Text, key


class Port(Record):
    port: str = key(Text(), "A serial port.", "/dev/ttyUSB0", "/dev/ttyUSB0")


class Thermometer:
    role = "monitor"
    Parameters = Port


class Wired(Thermometer):
    @classmethod
    def address(cls, parameters: Port) -> str:
        return parameters.port


class Simulated(Thermometer):
    def checkpoint(self) -> dict[str, Any]:
        return {}

    def restore(self, state: Any) -> None: ...


DRIVERS = {"plain": Thermometer, "wired": Wired, "simulated": Simulated}


@pytest.fixture(autouse=True)
def surroundings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(plugins, "names", lambda group: tuple(DRIVERS))
    monkeypatch.setattr(plugins, "load", lambda group, name: DRIVERS[name])
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(tmp_path / "locks"))
    monkeypatch.setattr(lock, "RESCUE_PATIENCE", 0.3)


def bench(instruments: str, name: str = "lab", clock: str = "wall") -> Bench:
    site = "site: {latitude: 40 deg, gravity: 9.8 m/s^2}"
    text = f"planrunner_bench: 1\nname: {name}\nclock: {clock}\n{site}\ninstruments: {instruments}\n"
    found, log = parse_bench(source.parse(text, "lab.yaml"))
    assert found is not None and not log.errors
    return found


def held(first: Bench, second: Bench) -> str:
    """Why the second cannot be had while the first is held; empty when it can."""
    with bench_lock(first, "first.yaml"):
        try:
            with bench_lock(second, "second.yaml"):
                return ""
        except InputError as error:
            (finding,) = error.findings
            assert finding.code == "bench-in-use" and str(finding).startswith("second.yaml:1:1")
            return finding.message


WIRED = "{t: {driver: wired, port: /dev/ttyUSB7}}"


def test_an_address_is_held_whatever_the_bench_is_called() -> None:
    told = held(bench(WIRED), bench("{other: {driver: wired, port: /dev/ttyUSB7}}", "hall"))
    assert told.startswith(f"this bench is in use: /dev/ttyUSB7 is held by a run, process {os.getpid()} of ")
    assert held(bench(WIRED), bench("{t: {driver: wired, port: /dev/ttyUSB8}}")) == ""


def test_an_instrument_without_an_address_is_held_by_its_name_on_the_bench() -> None:
    assert "bench lab: t is held" in held(bench("{t: {driver: plain}}"), bench("{t: {driver: plain}}"))
    assert held(bench("{t: {driver: plain}}"), bench("{t: {driver: plain}}", "hall")) == ""


def test_simulated_benches_are_shared() -> None:
    assert held(bench("{t: {driver: simulated}}"), bench("{t: {driver: simulated}}")) == ""
    assert held(bench(WIRED, clock="virtual"), bench(WIRED, clock="virtual")) == ""
    both = bench("{s: {driver: simulated}, t: {driver: plain}}")
    assert real_instruments(both) == ("t",)


def test_all_or_none_are_held() -> None:
    """A bench of which one instrument is taken gives the others back."""
    two = bench("{a: {driver: wired, port: A}, t: {driver: wired, port: /dev/ttyUSB7}}")
    with bench_lock(bench(WIRED), "first.yaml"):
        with pytest.raises(InputError), bench_lock(two, "second.yaml"):
            pass
        with bench_lock(bench("{a: {driver: wired, port: A}}"), "third.yaml"):
            pass
    with bench_lock(two, "second.yaml"):
        pass


def test_a_watchdog_is_waited_for_and_told() -> None:
    began = time.monotonic()
    with (
        bench_lock(bench(WIRED), "first.yaml", lock.RESCUE),
        pytest.raises(InputError, match="a watchdog makes it safe"),
        bench_lock(bench(WIRED), "second.yaml"),
    ):
        pass
    assert time.monotonic() - began >= 0.3


def test_a_folder_for_locks_that_cannot_be_made_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(tmp_path / "file" / "locks"))
    with pytest.raises(InputError) as error, bench_lock(bench(WIRED), "lab.yaml"):
        pass
    assert error.value.findings[0].code == "bench-lock" and "PLANRUNNER_LOCKS" in error.value.findings[0].hint


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="no such protection here")
def test_a_lock_is_never_taken_through_a_link(tmp_path: Path) -> None:
    """In a folder that everybody may write to, a link could make a lock write into somebody's file."""
    target = tmp_path / "precious"
    target.write_text("data", encoding="utf-8")
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(OSError, match="symbolic link"):
        ExclusiveFile(tmp_path / "link", "note")
    assert target.read_text(encoding="utf-8") == "data"


def test_a_file_that_is_held_tells_the_newest_note(tmp_path: Path) -> None:
    ExclusiveFile(tmp_path / "x", "a very long note of an earlier holder").release()
    first = ExclusiveFile(tmp_path / "x", "short")
    with pytest.raises(HeldError, match=r"^short$"):
        ExclusiveFile(tmp_path / "x", "mine")
    first.release()
    ExclusiveFile(tmp_path / "x", "mine").release()
