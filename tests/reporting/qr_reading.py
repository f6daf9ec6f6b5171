"""Reads a QR code of version 6, level M, from a picture, after ISO/IEC 18004. It shares no code with the library that makes the codes."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator

import numpy as np
from PIL import Image

SIZE = 41
"""Modules along a side of version 6."""
BLOCKS, DATA, CHECKS = 4, 27, 16
"""Version 6-M (Table 9): 4 blocks with 27 codewords of data and 16 of error correction each."""
MASKS: tuple[Callable[[int, int], bool], ...] = (
    lambda r, c: (r + c) % 2 == 0,
    lambda r, c: r % 2 == 0,
    lambda r, c: c % 3 == 0,
    lambda r, c: (r + c) % 3 == 0,
    lambda r, c: (r // 2 + c // 3) % 2 == 0,
    lambda r, c: r * c % 2 + r * c % 3 == 0,
    lambda r, c: (r * c % 2 + r * c % 3) % 2 == 0,
    lambda r, c: ((r + c) % 2 + r * c % 3) % 2 == 0,
)
"""Table 10."""


def read_code(png: bytes) -> str:
    """The text of the only code in a picture, whose dark modules are the only dark pixels."""
    dark = modules(png)
    _, mask = format_of(dark)
    words = list(codewords(dark, MASKS[mask]))
    data = words[: BLOCKS * DATA]
    checks = words[BLOCKS * DATA :]
    blocks = [data[block::BLOCKS] for block in range(BLOCKS)]
    for block, found in enumerate(blocks):
        assert not any(syndromes([*found, *checks[block::BLOCKS]])), f"block {block} has errors"
    stream = "".join(f"{word:08b}" for found in blocks for word in found)
    assert stream[:4] == "0100", "the code is not in byte mode"
    count = int(stream[4:12], 2)
    return bytes(int(stream[12 + 8 * k : 20 + 8 * k], 2) for k in range(count)).decode("ascii")


def modules(png: bytes) -> np.ndarray:
    """Whether each module is dark, shape (41, 41), from the centres of the modules."""
    grey = np.asarray(Image.open(io.BytesIO(png)).convert("L"))
    rows, columns = np.nonzero(grey < 128)
    top, bottom, left, right = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    assert abs((bottom - top) - (right - left)) <= 1, "the code is not square"
    centres = (np.arange(SIZE) + 0.5) / SIZE
    down, across = (top + centres * (bottom - top)).astype(int), (left + centres * (right - left)).astype(int)
    found: np.ndarray = grey[np.ix_(down, across)] < 128
    return found


def format_of(dark: np.ndarray) -> tuple[int, int]:
    """Level and mask from the format information (7.9), whose two copies must agree."""
    first = [(8, c) for c in (0, 1, 2, 3, 4, 5, 7, 8)] + [(r, 8) for r in (7, 5, 4, 3, 2, 1, 0)]
    second = [(SIZE - 1 - k, 8) for k in range(7)] + [(8, SIZE - 8 + k) for k in range(8)]
    one, other = (int("".join(str(int(dark[place])) for place in places), 2) for places in (first, second))
    assert one == other
    bits = one ^ 0b101010000010010
    level, mask = bits >> 13, bits >> 10 & 0b111
    assert level == 0b00, "the code is not of level M"
    return level, mask


def codewords(dark: np.ndarray, mask: Callable[[int, int], bool]) -> Iterator[int]:
    """The codewords in their order (7.7.3), without the mask."""
    bits, upward = [], True
    for right in (*range(SIZE - 1, 6, -2), *range(5, 0, -2)):
        for r in range(SIZE - 1, -1, -1) if upward else range(SIZE):
            bits += [int(dark[r, c]) ^ mask(r, c) for c in (right, right - 1) if not is_pattern(r, c)]
        upward = not upward
    for k in range(BLOCKS * (DATA + CHECKS)):
        yield int("".join(map(str, bits[8 * k : 8 * k + 8])), 2)


def is_pattern(r: int, c: int) -> bool:
    """Whether a module belongs to the finders with their formats, the timing, or the alignment pattern."""
    corner = (r < 9 and c < 9) or (r < 9 and c >= SIZE - 8) or (r >= SIZE - 8 and c < 9)
    return corner or r == 6 or c == 6 or (32 <= r <= 36 and 32 <= c <= 36)


def syndromes(block: list[int]) -> list[int]:
    """Values of the block as a polynomial over GF(256) at the roots of the generator (7.5.2); all are 0 without errors."""
    found = []
    for power in range(CHECKS):
        value = 0
        for word in block:
            value = times(value, raised(power)) ^ word
        found.append(value)
    return found


def raised(power: int) -> int:
    value = 1
    for _ in range(power):
        value = times(value, 2)
    return value


def times(one: int, other: int) -> int:
    """Product in GF(256) modulo x⁸ + x⁴ + x³ + x² + 1."""
    product = 0
    while other:
        if other & 1:
            product ^= one
        one, other = one << 1 ^ (0x11D if one & 0x80 else 0), other >> 1
    return product
