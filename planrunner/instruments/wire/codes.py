"""Defines the codes that compiled kernels use for kinds of checksums, rules of framing and kinds of numbers."""

from __future__ import annotations

UNSIGNED, SIGNED, FLOAT, FRACTION_FIRST = range(4)


FIXED, XBUS, LINE = range(3)


NONE, CRC, SUM, NEGATIVE_SUM, XOR = range(5)
