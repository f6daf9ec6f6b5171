"""Rounding by the uncertainty: cases as a metrologist writes them."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planrunner.reporting.rounding import rounded

CASES = [
    (-1.234567, 0.00213, "-1.2346 ± 0.0021"),
    (100.02147, 0.00035, "100.02147 ± 0.00035"),  # JCGM 100:2008, 7.2.2
    (1.5e-7, 1.2e-10, "(1.5000 ± 0.0012)e-07"),
    (12411, 1300, "12400 ± 1300"),
    (0.0999, 0.00996, "0.100 ± 0.010"),
    (0, 0.1, "0.00 ± 0.10"),
    (-0.00001, 0.1, "0.00 ± 0.10"),
    (0.5, 20, "0 ± 20"),
    (3e7, 1e4, "(3.0000 ± 0.0010)e+07"),
    (1, 1e12, "(0.0 ± 1.0)e+12"),
    (2.5, 0.995, "2.5 ± 1.0"),
    (0.125, 0.10, "0.12 ± 0.10"),
    (5, 0, "5"),
    (1e-12, 0, "1e-12"),
    (0, 0, "0"),
    (5, math.inf, "5 ± ∞"),
    (5, math.nan, "5 ± not known"),
    (math.nan, 1, "not known ± 1"),
    (-math.inf, 0, "-∞"),
]


@pytest.mark.parametrize(("value", "u", "text"), CASES)
def test_cases(value: float, u: float, text: str) -> None:
    assert str(rounded(value, u)) == text


@given(st.floats(-1e200, 1e200), st.floats(1e-200, 1e200))
def test_text_says_the_same_to_the_last_digit(value: float, u: float) -> None:
    text = rounded(value, u)
    power = 10.0**text.exponent
    shown = float(text.uncertainty) * power
    assert shown == pytest.approx(u, rel=0.0500001)
    if abs(value) / u < 1e12:
        assert float(text.value) * power == pytest.approx(value, abs=0.051 * u, rel=1e-12)
    digits = re.sub(r"^[0.]+", "", text.uncertainty).replace(".", "")
    assert len(digits) >= 2
    decimals = [len(part.partition(".")[2]) for part in (text.value, text.uncertainty)]
    assert decimals[0] == decimals[1]


@given(st.floats(), st.floats())
def test_never_fails(value: float, u: float) -> None:
    assert str(rounded(value, u))
