"""Limits held against quantities on a circle, such as a heading, and on a line."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.estimators.limits import hold
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.model import Limit


def limit(text: str) -> Limit:
    log = Findings()
    made = RecordOf(Limit).read(source.parse(f"quantity: nav.heading\n{text}", "plan.yaml"), log)
    assert list(log) == []
    return made


def verdict(value: float, text: str, period: float = 360.0) -> str:
    heading = Coefficient("heading", value, "deg", 1e-6, period=period)
    return hold(limit(text), {"nav": Estimate("nav", "e", (heading,), np.eye(1))}).verdict


@pytest.mark.parametrize(
    ("value", "text", "expected"),
    [
        (359.88, "within: ±1 deg", "pass"),
        (0.12, "within: ±1 deg", "pass"),
        (358.0, "within: ±1 deg", "fail"),
        (-0.5, "within: ±1 deg", "pass"),
        (0.5, "{at_least: 359 deg, at_most: 361 deg}", "pass"),
        (180.0, "{at_least: 359 deg, at_most: 361 deg}", "fail"),
        (359.9, "at_least: 350 deg", "pass"),
    ],
)
def test_a_heading_is_compared_on_the_circle(value: float, text: str, expected: str) -> None:
    assert verdict(value, text.strip("{}").replace(", ", "\n")) == expected


def test_what_lies_on_a_line_is_compared_as_it_is() -> None:
    assert verdict(359.88, "within: ±1 deg", math.inf) == "fail"
