"""Fields of frames against the standard library's `struct` and `int.from_bytes`."""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np
import pytest

from planrunner.instruments.wire.codes import FLOAT, FRACTION_FIRST, SIGNED, UNSIGNED
from planrunner.instruments.wire.columns import Field, numbers, whole_numbers
from planrunner.instruments.wire.framing import Frames

ROWS, LENGTH = 200, 16


@pytest.fixture(scope="module")
def frames() -> Frames:
    data = np.random.default_rng(5).integers(0, 256, ROWS * LENGTH, dtype=np.uint8)
    data[:LENGTH], data[LENGTH : 2 * LENGTH] = 0xFF, 0x80
    starts = np.arange(ROWS) * LENGTH
    return Frames(data, starts, np.full(ROWS, LENGTH), np.zeros(ROWS))


def rows(frames: Frames, offset: int, width: int) -> list[bytes]:
    return [frames.data[start + offset : start + offset + width].tobytes() for start in frames.starts]


@pytest.mark.parametrize("width", range(1, 9))
@pytest.mark.parametrize("kind", [SIGNED, UNSIGNED])
@pytest.mark.parametrize("little", [False, True])
def test_integers(frames: Frames, width: int, kind: int, little: bool) -> None:
    order: Literal["little", "big"] = "little" if little else "big"
    want = [int.from_bytes(row, order, signed=kind == SIGNED) for row in rows(frames, 3, width)]
    item = Field(3, width, kind, 0.5, little)
    scaled = [number * 0.5 for number in want]
    exact = 1e-15 if width == 8 else 0.0  # beyond 53 bits a float rounds
    assert numbers(frames, [item])[0] == pytest.approx(scaled, rel=exact, abs=0.0)
    wrapped = [number - 2**64 if number >= 2**63 else number for number in want]
    assert whole_numbers(frames, item).tolist() == wrapped


@pytest.mark.parametrize(("width", "code"), [(4, "f"), (8, "d")])
@pytest.mark.parametrize("little", [False, True])
def test_floats(frames: Frames, width: int, code: str, little: bool) -> None:
    want = [struct.unpack(("<" if little else ">") + code, row)[0] for row in rows(frames, 5, width)]
    found = numbers(frames, [Field(0, 2), Field(5, width, FLOAT, little=little)])[1]
    np.testing.assert_array_equal(found, np.array(want))


def test_fraction_first() -> None:
    data = np.frombuffer(bytes.fromhex("80000000fffe") + bytes.fromhex("400000000003"), np.uint8)
    frames = Frames(data, np.array([0, 6]), np.array([6, 6]), np.zeros(2))
    assert numbers(frames, [Field(0, 6, FRACTION_FIRST)])[0].tolist() == [-1.5, 3.25]


def test_no_frames_and_no_fields(frames: Frames) -> None:
    assert numbers(frames, []).shape == (0, ROWS)
    nothing = frames.of(np.zeros(ROWS, bool))
    assert numbers(nothing, [Field(0, 2)]).shape == (1, 0)
