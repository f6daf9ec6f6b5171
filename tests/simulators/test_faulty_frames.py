"""Faults of frames: as many as were asked for, and of the kind; scripts and messages of faults that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import InputError
from planrunner.simulators.faults import Fault, FaultBoard, read_fault, read_script, struck

ROLES = {"table": "table", "chamber": "chamber", "gyro": "sensor"}


def frames(count: int) -> np.ndarray:
    """Frames that carry their number."""
    numbers = np.arange(count)
    return np.stack([numbers >> 8, numbers & 255, 0 * numbers, 0 * numbers], axis=1).astype(np.uint8)


def numbers(sent: np.ndarray) -> np.ndarray:
    return sent[:, 0].astype(int) * 256 + sent[:, 1]


def fault(kind: str, share: str = "100 %") -> Fault:
    return read_fault(f"{{instrument: gyro, fault: {kind}, share: {share}}}", ROLES)


@pytest.fixture
def draw() -> np.random.Generator:
    return np.random.default_rng(7)


def test_one_byte_of_a_share_is_corrupt(draw: np.random.Generator) -> None:
    sent, good = struck(frames(20_000), [fault("corrupt", "1 %")], draw), frames(20_000)
    different = np.count_nonzero(sent != good, axis=1)
    assert set(different) == {0, 1}
    assert 140 < np.count_nonzero(different) < 260  # 200, six standard deviations wide


def test_lost_doubled_and_swapped_frames(draw: np.random.Generator) -> None:
    assert len(struck(frames(100), [fault("silent")], draw)) == 0
    lost = numbers(struck(frames(20_000), [fault("lose", "50 %")], draw))
    assert 9_500 < lost.size < 10_500 and np.all(np.diff(lost) > 0)
    doubled = numbers(struck(frames(100), [fault("duplicate")], draw))
    assert doubled.tolist() == sorted([*range(100), *range(100)])
    swapped = numbers(struck(frames(20_000), [fault("reorder", "10 %")], draw))
    assert sorted(swapped.tolist()) == list(range(20_000))
    assert np.count_nonzero(np.diff(swapped) < 0) > 1_000


def test_another_baud_rate_makes_two_bytes_of_one(draw: np.random.Generator) -> None:
    """0x05 is 10100000 from its lowest bit on: doubled 1100110000000000, which is 33 and 00."""
    sent = struck(np.array([[0x05]], dtype=np.uint8), [fault("wrong baud")], draw)
    assert sent.tobytes().hex() == "3300"


def test_a_fault_stands_from_its_beginning_to_its_end() -> None:
    board = FaultBoard()
    board.declare(read_fault("{instrument: table, fault: interlock open, at: 10 s, for: 5 s}", ROLES), 100.0)
    assert board.changes(105.0) == ([], [])
    begun, over = board.changes(110.0)
    assert [item.fault for item in begun] == ["interlock open"] and not over
    assert board.active("table", 112.0) and not board.active("chamber", 112.0)
    begun, over = board.changes(115.0)
    assert not begun and [item.fault for item in over] == ["interlock open"]
    assert not board.standing


def test_a_fault_of_replies_takes_so_many_of_those_that_it_means() -> None:
    board = FaultBoard()
    number = board.declare(read_fault("{instrument: chamber, fault: silent, count: 2, message: PVAL}", ROLES), 0.0)
    assert number == 1
    assert board.of_reply("chamber", ":SOURCE:CLOOP1:ERROR?", 1.0) is None
    assert [board.of_reply("chamber", "PVALUE?", 1.0) is not None for _ in range(3)] == [True, True, False]


def test_clearing_ends_a_fault_at_once() -> None:
    board = FaultBoard()
    board.declare(read_fault("{instrument: gyro, fault: unplug}", ROLES), 0.0)
    board.changes(1.0)
    board.clear(1)
    assert not board.active("gyro", 1.0)
    assert [item.fault for item in board.changes(1.0)[1]] == ["unplug"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{instrument: tabel, fault: silent}", "'tabel' is not an instrument"),
        ("{instrument: chamber, fault: over-rate}", "cannot have the fault"),
        ("{instrument: table, fault: sleepy}", "sleepy"),
        ("{instrument: gyro, fault: lose, share: -1 %}", "must be positive"),
        ("{fault: silent}", "instrument"),
        ("[1, 2]", "keys and values"),
    ],
)
def test_a_fault_that_is_wrong_is_reported(text: str, told: str) -> None:
    with pytest.raises(InputError) as error:
        read_fault(text, ROLES)
    assert told in " ".join(item.message for item in error.value.findings)


def test_all_mistakes_of_a_script_are_reported(tmp_path: Path) -> None:
    script = tmp_path / "faults.yaml"
    script.write_text(
        "planrunner_faults: 1\nfaults:\n  - {instrument: oven, fault: silent}\n  - {instrument: table, fault: stuck}\n",
        encoding="utf-8",
    )
    with pytest.raises(InputError) as error:
        read_script(script, ROLES)
    assert [item.mark.line for item in error.value.findings] == [3, 4]
    script.write_text("planrunner_faults: 1\nfaults: [{instrument: oven, fault: silent}]\n", encoding="utf-8")
    with pytest.raises(InputError):
        read_script(script, ROLES)
