"""One run a bench: what is locked, who is told, and that locks come back. Across processes: tests/lab."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from planrunner.base import exclusive, plugins
from planrunner.base.exclusive import ExclusiveFile, HeldError
from planrunner.base.findings import InputError
from planrunner.bench import lock
from planrunner.bench.lock import bench_lock, lock_folder, watchdog_lock
from planrunner.bench.model import Bench, parse_bench, real_instruments
from planrunner.plan import source
from planrunner.plan.kinds import Record, Text, key


class Port(Record):
    port: str = key(Text(), "A serial port.", "/dev/ttyUSB0", default="/dev/ttyUSB0")


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


def test_a_watchdog_is_waited_for_and_reported() -> None:
    began = time.monotonic()
    with (
        watchdog_lock(bench(WIRED), "first.yaml"),
        pytest.raises(InputError, match="the watchdog of another run, which is making the bench safe, process"),
        bench_lock(bench(WIRED), "second.yaml"),
    ):
        pass
    assert time.monotonic() - began >= 0.3


def test_the_watchdog_of_a_run_takes_its_own_lock_beside_that_of_the_run() -> None:
    """So that nobody comes between when the run is killed: its own lock ends then, that of its watchdog does not."""
    with bench_lock(bench(WIRED), "first.yaml"), watchdog_lock(bench(WIRED), "first.yaml"):
        pass
    with watchdog_lock(bench(WIRED), "first.yaml"), pytest.raises(InputError), watchdog_lock(bench(WIRED), "x.yaml"):
        pass


def test_a_folder_for_locks_that_cannot_be_made_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(tmp_path / "file" / "locks"))
    assert "cannot be used" in refused()
    monkeypatch.setenv("PLANRUNNER_LOCKS", "locks")
    assert "give its absolute path" in refused()


def refused() -> str:
    """Why there is no safe place for locks."""
    with pytest.raises(InputError) as error, bench_lock(bench(WIRED), "lab.yaml"):
        pass
    (finding,) = error.value.findings
    assert finding.code == "bench-lock" and "PLANRUNNER_LOCKS" in finding.hint
    return finding.message


POSIX = pytest.mark.skipif(sys.platform == "win32", reason="modes and owners are POSIX")


@POSIX
def test_the_place_of_locks_is_the_same_whatever_the_environment_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("PLANRUNNER_LOCKS")
    first = lock_folder()
    for name in ("TMPDIR", "TEMP", "TMP", "HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.chdir(tmp_path)
    assert lock_folder() == first and first.stat().st_uid == 0 and first.stat().st_mode & 0o1022 > 0o1000


@POSIX
def test_shared_places_are_taken_in_their_order_and_never_passed_over_for_their_owner(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What is not for all is no place for locks; one that is, but could be anybody's, is a reason to stop, not to look elsewhere."""
    monkeypatch.delenv("PLANRUNNER_LOCKS")
    places = [tmp_path / name for name in "abc"]
    monkeypatch.setitem(lock.PLACES, sys.platform, tuple(map(str, places)))
    with pytest.raises(OSError, match="no folder that all its users share"):
        lock_folder()
    for place, mode in zip(places, (0o755, 0o1777, 0o1777), strict=True):
        place.mkdir()
        place.chmod(mode)
    assert lock_folder() == places[1]
    tmp_path.chmod(0o777)
    assert "others may write to" in refused()


@POSIX
def test_a_folder_that_is_there_keeps_its_mode_and_one_that_others_may_change_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / "mine"
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(folder))
    folder.mkdir()
    for mode, message in ((0o755, ""), (0o1777, ""), (0o777, "others may write to"), (0o775, "others may write to")):
        folder.chmod(mode)
        if message:
            assert message in refused()
        else:
            assert lock_folder() == folder
        assert folder.stat().st_mode & 0o7777 == mode


@POSIX
def test_a_link_in_place_of_the_folder_is_refused_and_its_target_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.mkdir(mode=0o700)
    link.symlink_to(target)
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(link))
    assert "is a link" in refused()
    assert target.stat().st_mode & 0o7777 == 0o700 and not list(target.iterdir())


@POSIX
def test_a_folder_that_is_made_here_is_for_all_only_when_an_administrator_makes_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(tmp_path / "new"))
    assert lock_folder().stat().st_mode & 0o7777 == (0o1777 if os.geteuid() == 0 else 0o700)


@pytest.mark.skipif(sys.platform == "win32", reason="ports have one name there, but for its spelling")
def test_two_names_of_one_port_are_one_instrument(tmp_path: Path) -> None:
    """A link as in /dev/serial/by-id, a VISA resource, a way round: any of them finds the port held."""
    ours, theirs = os.openpty()
    port, link = os.ttyname(theirs), tmp_path / "usb-gyro-port0"
    link.symlink_to(port)
    names = [port, str(link), f"ASRL{port}::INSTR", f"asrl{link}", f"/dev/../{port}", f"spy://{link}?file=x"]
    for name in names[1:]:
        for first, second in ((port, name), (name, port)):
            told = held(
                bench(f"{{t: {{driver: wired, port: '{first}'}}}}"),
                bench(f"{{t: {{driver: wired, port: '{second}'}}}}", "hall"),
            )
            assert f"{second} is held by" in told, name
    os.close(ours)
    os.close(theirs)


@POSIX
@pytest.mark.parametrize("kind", ["pipe", "folder", "second name"])
def test_what_is_planted_in_place_of_a_lock_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    path, precious = tmp_path / "x.lock", tmp_path / "precious"
    precious.write_text("data", encoding="utf-8")
    {"pipe": os.mkfifo, "folder": os.mkdir, "second name": lambda place: os.link(precious, place)}[kind](path)
    with pytest.raises(OSError, match="not a regular file with one name"):
        ExclusiveFile(path, "note")
    assert precious.read_text(encoding="utf-8") == "data"


def test_a_lock_that_is_removed_before_it_is_held_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the next process would make, and hold, another file of the same name."""
    path = tmp_path / "x.lock"
    taken: list[int] = []
    locked = exclusive._lock

    def slowly(descriptor: int) -> None:
        if not taken:
            path.unlink()
        taken.append(descriptor)
        locked(descriptor)

    monkeypatch.setattr(exclusive, "_lock", slowly)
    first = ExclusiveFile(path, "first")
    assert len(taken) == 2
    with pytest.raises(HeldError, match="first"):
        ExclusiveFile(path, "second")
    first.release()


def test_a_note_of_another_user_cannot_command_the_terminal(tmp_path: Path) -> None:
    first = ExclusiveFile(tmp_path / "x", "a run\x1b]0;gotcha\x07 of \u202enobody " + "x" * 1000)
    with pytest.raises(HeldError) as error:
        ExclusiveFile(tmp_path / "x")
    first.release()
    assert str(error.value).isprintable() and len(str(error.value)) < 400


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="no such protection here")
def test_a_lock_is_never_taken_through_a_link(tmp_path: Path) -> None:
    """In a folder that everybody may write to, a link could make a lock write into somebody's file."""
    target = tmp_path / "precious"
    target.write_text("data", encoding="utf-8")
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(OSError, match="symbolic link"):
        ExclusiveFile(tmp_path / "link", "note")
    assert target.read_text(encoding="utf-8") == "data"


def test_a_held_file_gives_the_newest_note(tmp_path: Path) -> None:
    ExclusiveFile(tmp_path / "x", "a very long note of an earlier holder").release()
    first = ExclusiveFile(tmp_path / "x", "short")
    with pytest.raises(HeldError, match=r"^short$"):
        ExclusiveFile(tmp_path / "x", "mine")
    first.release()
    ExclusiveFile(tmp_path / "x", "mine").release()
