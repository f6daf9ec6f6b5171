"""The journal: its chain, torn last lines, lines changed afterwards, and writes that fail."""

from __future__ import annotations

import hashlib
import json
from io import FileIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import FIRST, Journal, JournalScan, finite
from planrunner.archive.storage import Storage
from planrunner.base.guarded_folder import GuardedFolder


def write(path: Path, events: int, storage: Storage | None = None) -> Journal:
    storage = storage or Storage("flushed")
    journal = Journal(storage, storage.open_new(GuardedFolder.open(path.parent), path.name))
    for number in range(events):
        journal.append("failed", {"where": "here", "kind": "K", "message": f"±{number}"})
    return journal


def test_each_line_carries_the_digest_of_the_line_before(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = write(path, 4)
    journal.close()
    previous = FIRST
    for number, line in enumerate(path.read_bytes().split(b"\n")[:-1]):
        event = json.loads(line)
        assert (event["seq"], event["previous"], event["message"]) == (number + 1, previous, f"±{number}")
        previous = hashlib.sha256(line).hexdigest()
    assert journal.head == previous


def test_scan_gives_events_and_end(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = write(path, 3)
    journal.close()
    scan = JournalScan(GuardedFolder.open(path.parent))
    assert [event["message"] for event in scan] == ["±0", "±1", "±2"]
    assert (scan.head, scan.count, scan.size, scan.torn) == (journal.head, 3, path.stat().st_size, 0)


def test_every_torn_end_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    write(path, 3).close()
    whole = path.read_bytes()
    second = whole.index(b"\n", whole.index(b"\n") + 1) + 1
    for length in range(second, len(whole)):
        path.write_bytes(whole[:length])
        scan = JournalScan(GuardedFolder.open(path.parent))
        assert len(list(scan)) == 2
        assert (scan.size, scan.torn) == (second, length - second)


def test_zeros_at_the_end_are_torn(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    write(path, 3).close()
    whole = path.read_bytes()
    for hole in (bytes(100), bytes(100) + b'"tail"}\n'):
        path.write_bytes(whole + hole)
        scan = JournalScan(GuardedFolder.open(path.parent))
        assert len(list(scan)) == 3
        assert (scan.size, scan.torn) == (len(whole), len(hole))
    path.write_bytes(whole[:100] + bytes(10) + whole[110:])
    with pytest.raises(IntegrityError):
        list(JournalScan(GuardedFolder.open(path.parent)))


@settings(max_examples=300, deadline=None)
@given(place=st.integers(0, 10_000), byte=st.integers(0, 255))
def test_a_changed_byte_before_the_last_line_is_found(
    tmp_path_factory: pytest.TempPathFactory, place: int, byte: int
) -> None:
    folder = tmp_path_factory.getbasetemp() / "changed"
    folder.mkdir(exist_ok=True)
    path = folder / "journal.jsonl"
    write(path, 4).close()
    data = bytearray(path.read_bytes())
    place %= data[:-1].rindex(b"\n") + 1
    if data[place] == byte:
        byte ^= 1
    data[place] = byte
    path.write_bytes(data)
    with pytest.raises(IntegrityError, match="changed after it was written"):
        list(JournalScan(GuardedFolder.open(path.parent)))


def test_a_zero_for_a_line_feed_does_not_swallow_a_line_that_counts(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    write(path, 4).close()
    data = bytearray(path.read_bytes())
    data[data[:-1].rindex(b"\n")] = 0
    path.write_bytes(data)
    with pytest.raises(IntegrityError, match="changed after it was written"):
        list(JournalScan(GuardedFolder.open(path.parent)))


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_missing_line_is_found(tmp_path: Path, lost: int) -> None:
    path = tmp_path / "journal.jsonl"
    write(path, 4).close()
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:lost] + lines[lost + 1 :]))
    with pytest.raises(IntegrityError, match=f"journal.jsonl:{lost + 1}:"):
        list(JournalScan(GuardedFolder.open(path.parent)))


class FailingOnce(Storage):
    """Writes half a line, then raises, once."""

    def __init__(self, error: BaseException, at: int):
        super().__init__("flushed")
        self.error, self.left = error, at

    def write(self, file: FileIO, data: bytes | memoryview) -> None:
        self.left -= 1
        if self.left == 0:
            super().write(file, data[: len(data) // 2])
            raise self.error
        super().write(file, data)


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_fails_did_not_happen(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "journal.jsonl"
    storage = FailingOnce(error, 3)
    journal = write(path, 2, storage)
    with pytest.raises(type(error)):
        journal.append("failed", {"where": "w", "kind": "k", "message": "lost"})
    journal.append("failed", {"where": "w", "kind": "k", "message": "after"})
    journal.close()
    assert [event["message"] for event in JournalScan(GuardedFolder.open(path.parent))] == ["±0", "±1", "after"]


def test_what_json_cannot_carry_is_refused_or_null(tmp_path: Path) -> None:
    journal = write(tmp_path / "journal.jsonl", 1)
    with pytest.raises(ValueError, match="JSON"):
        journal.append("segment", {"clock": float("nan")})
    journal.append("failed", {"message": "\udc80"})
    journal.close()
    assert [event["message"] for event in JournalScan(GuardedFolder.open(tmp_path))] == ["±0", "\udc80"]
    assert finite({"a": float("inf"), "b": 1.5}) == {"a": None, "b": 1.5}
