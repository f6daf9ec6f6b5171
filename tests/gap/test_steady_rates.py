"""Warnings about turning segments whose rate is not constant, and the note about the reference of a recorded motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.recording_checks import check_observed
from planrunner.plan.schedule import RecordedMotion, Spin
from tests.gap.turntable import record


def warned(seen: Observed) -> list[str]:
    log = Findings()
    check_observed(seen, "recording", log)
    return [one.message for one in log if one.code == "gap-unsteady-rate"]


def changed(seen: Observed, factor: np.ndarray) -> Observed:
    """The recording with the outputs of its fourth turning segment multiplied by a factor (n,) on the gyros."""
    turning = [index for index, motion in enumerate(seen.motions) if isinstance(motion, Spin)]
    values = seen.values.copy()
    values[seen.segments()[turning[3]], :3] *= factor[:, None]
    return replace(seen, values=values)


@pytest.fixture(scope="module")
def steady() -> Observed:
    return record(seed=3)


def test_a_steady_rate_is_not_warned_of(steady: Observed) -> None:
    assert warned(steady) == []


@pytest.mark.parametrize("way", [1, -1])
def test_a_table_that_spins_up_or_slows_down_is_warned_of(steady: Observed, way: int) -> None:
    since = np.arange(400) / 20.0  # s
    (message,) = warned(changed(steady, np.minimum(since / 2.5, 1.0)[::way]))
    assert "for about 2 s" in message or "for about 3 s" in message


def test_a_turn_by_hand_is_warned_of(steady: Observed) -> None:
    share = np.arange(400) / 400
    (message,) = warned(changed(steady, 1 - np.cos(2 * np.pi * share)))
    assert "for about 20 s" in message


@pytest.mark.parametrize("sigma", [0.2, 2.0])  # deg/s
def test_the_noise_of_a_reference_is_a_limit_of_scale_factors(steady: Observed, sigma: float) -> None:
    """The slope of a regression on a noisy rate is too small by the stated share, on the average over 300 draws."""
    draw = np.random.default_rng(4)
    rate = 20 * np.sin(np.arange(400) / 20)  # deg/s
    lost = np.mean([1 - np.polyfit(rate + draw.normal(0, sigma, 400), rate, 1)[0] for _ in range(300)])
    shown = steady.rate.copy()
    shown[:400] = np.deg2rad(rate + draw.normal(0, sigma, 400))
    log = Findings()
    motions = (RecordedMotion(angle="encoder"), *steady.motions[1:])
    check_observed(replace(steady, motions=motions, rate=shown), "recording", log)
    (message,) = [one.message for one in log if one.code == "gap-reference"]
    assert float(message.split()[-2]) == pytest.approx(lost * 1e6, rel=0.2)


def test_a_fast_motion_hides_the_noise_of_the_reference(steady: Observed) -> None:
    shown = steady.rate.copy()
    shown[:400] = np.deg2rad(20 * np.sin(np.arange(400) * 2.0))
    log = Findings()
    motions = (RecordedMotion(angle="encoder"), *steady.motions[1:])
    check_observed(replace(steady, motions=motions, rate=shown), "recording", log)
    (message,) = [one.message for one in log if one.code == "gap-reference"]
    assert message.endswith("by an amount that the fast motion hides")


@pytest.mark.parametrize(("limit", "count"), [(0.6, 0.0), (0.6, 1e-3), (np.inf, 0.0), (np.inf, 0.2)])
def test_a_limit_of_the_output_is_named_with_its_value(steady: Observed, limit: float, count: float) -> None:
    values = steady.values.copy()
    values[:, 0] = np.random.default_rng(3).normal(0, 0.3, len(values))
    values[:, 0] = np.clip(np.round(values[:, 0] / count) * count if count else values[:, 0], -limit, limit)
    log = Findings()
    motions = (RecordedMotion(angle="encoder"),) * len(steady)
    check_observed(replace(steady, motions=motions, values=values), "recording", log)
    found = [one.message for one in log if one.code == "gap-saturated" and steady.channels[0].name in one.message]
    assert len(found) == (2 if limit < np.inf else 0)
    assert all(f"{np.degrees(limit):.4g} deg/s" in message for message in found)


@pytest.mark.parametrize(("limit", "named"), [(np.inf, []), (10.0, [10.0])])
def test_a_long_rest_in_coarse_counts_is_no_limit(steady: Observed, limit: float, named: list[float]) -> None:
    """The reference rests in nine of ten samples and turns at up to 30 deg/s in one direction. The smallest value of the output is that
    at rest. A limit is named only where the reference shows larger rates."""
    samples = len(steady.values)
    phase = np.arange(samples) % 1000
    rate = np.where(phase < 100, 30.0 * np.sin(np.pi * phase / 100), 0.0)  # deg/s
    output = np.clip(np.round((1.002 * rate + 0.1) / 0.5) * 0.5, -limit, limit)
    rates = np.deg2rad(np.column_stack([rate, np.zeros(samples), np.zeros(samples)]))
    values = steady.values.copy()
    values[:, 0] = np.deg2rad(output)
    motions = (RecordedMotion(angle="encoder"),) * len(steady)
    recorded = replace(steady, motions=motions, values=values, felt=(rates, steady.force))
    log = Findings()
    check_observed(recorded, "recording", log)
    found = [one.message for one in log if one.code == "gap-saturated" and steady.channels[0].name in one.message]
    assert len(found) == len(named)
    assert all(f"value {value:.4g} deg/s" in message for value, message in zip(named, found, strict=True))
