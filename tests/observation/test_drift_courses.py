"""Courses of a drift: their means over segments by numbers worked out by hand, and what a plan may ask for."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.observation.drift import asked, in_time, thermometer_of
from planrunner.observation.refusals import EstimationError


def test_courses_in_time_are_means_over_segments() -> None:
    """Segments from 0 to 1 h and from 3 to 4 h: the middle is at 2 h. Means of (t − 2)ⁿ over them: −1.5 and 1.5; 7/3 twice; −3.75 and
    3.75. Their average over the recorded time is subtracted."""
    linear, quadratic, cubic = in_time(np.array([0.0, 10800]), np.array([3600.0, 14400]), np.array([3600.0, 3600]))
    assert linear.columns[:, 0] == pytest.approx([-1.5, 1.5])
    assert quadratic.columns[:, 0] == pytest.approx([0.0, 0.0])
    assert cubic.columns[:, 0] == pytest.approx([-3.75, 3.75])
    assert (linear.per, quadratic.per, cubic.per) == ("h", "h^2", "h^3")


def test_constants_are_averages_over_the_recorded_time() -> None:
    """A segment that is three times as long counts three times."""
    start, seconds = np.array([0.0, 7200]), np.array([1800.0, 5400])
    for course in in_time(start, start + seconds, seconds):
        assert seconds @ course.columns[:, 0] == pytest.approx(0.0, abs=1e-9)


def test_short_segments_long_after_the_start_keep_their_digits() -> None:
    """A minute of a test that lasts a year: the mean of x³ over it is x³ at its middle, but for 3·x·(1/60 h)²/12."""
    start = np.array([0.0, 365 * 24 * 3600.0])
    cubic = in_time(start, start + 60, np.full(2, 60.0))[2].columns[:, 0]
    middle = 365 * 12.0
    assert cubic == pytest.approx([-(middle**3) - middle / 14400, middle**3 + middle / 14400], rel=1e-12)


def test_higher_orders_include_the_lower_ones() -> None:
    assert asked(["quadratic"]) == ("linear", "quadratic")
    assert asked(["temperature", "cubic"]) == ("linear", "quadratic", "cubic", "temperature")
    assert asked(["none"]) == ()


@pytest.mark.parametrize("words", [["none", "linear"], ["temperature", "by_evidence"]])
def test_words_that_exclude_each_other_are_refused(words: list[str]) -> None:
    with pytest.raises(EstimationError, match="excludes") as refused:
        asked(words)
    assert refused.value.key == "drift"


def test_the_only_thermometer_is_used() -> None:
    units = {"gyro_z": "deg/s", "case": "degC", "counts": "parsecs per fortnight"}
    assert thermometer_of(units, None, by_evidence=False) == "case"
    assert thermometer_of({"gyro_z": "deg/s"}, None, by_evidence=True) is None


def test_several_thermometers_need_a_name() -> None:
    units = {"case": "degC", "chamber": "K"}
    assert thermometer_of(units, None, by_evidence=True) is None
    assert thermometer_of(units, "case", by_evidence=False) == "case"
    with pytest.raises(EstimationError, match="case, chamber"):
        thermometer_of(units, None, by_evidence=False)


@pytest.mark.parametrize("channel", ["gyro_z", "nothing"])
def test_a_channel_that_is_no_temperature_is_refused(channel: str) -> None:
    with pytest.raises(EstimationError, match=channel) as refused:
        thermometer_of({"gyro_z": "deg/s", "case": "degC"}, channel, by_evidence=False)
    assert refused.value.key == "temperature_channel"


def test_a_drift_with_temperature_needs_a_thermometer() -> None:
    with pytest.raises(EstimationError, match="thermometer"):
        thermometer_of({"gyro_z": "deg/s"}, None, by_evidence=False)
