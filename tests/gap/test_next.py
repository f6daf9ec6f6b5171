"""What to measure next, on recordings whose explanations differ where it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions, diagnose
from planrunner.gap.answer.next import FEWEST, SegmentProposal, _instruments, propose
from planrunner.plan.schedule import Motion, Rest, Segment, Spin
from tests.gap.turntable import DEG, GYRO_WHITE, Fault, G, _frames, record

Array = np.ndarray
EFFECTS = ("gyro_g_sensitivity", "gyro_scale_asymmetry", "table_tilt", "gyro_warm_up", "table_rate_error")


def _asymmetry(size: float) -> Fault:
    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return np.abs(omega) * np.array([0.0, 0.0, size]), 0.0

    return fault


def _options(rates: tuple[float, ...] = (20.0, 90.0), frames: int = 12) -> list[Segment]:
    found: list[Segment] = []
    motions: tuple[Motion, ...] = (Rest(), *(Spin(sign * rate * DEG) for rate in rates for sign in (1, -1)))
    for frame in _frames()[:frames]:
        for motion in motions:
            found.append(Segment(len(found), f"O{len(found)}", frame, "", motion, 40.0))
    return found


def _proposed(found: Diagnosis, options: list[Segment], soak: float = 0.0) -> SegmentProposal | None:
    """soak: s, before the first of the segments, but not before a ramp."""
    grounds = found.grounds
    return propose(
        grounds.weighing,
        found.posterior,
        grounds.candidates,
        grounds.nominal,
        options,
        lambda before, segment: (
            10.0 + (segment.dwell or 0.0) + (0.0 if before or segment.ramp_to is not None else soak)
        ),
        1500.0,
    )


@pytest.fixture(scope="module")
def weak() -> Diagnosis:
    """An asymmetry that is neither named nor excluded."""
    for size in np.geomspace(2.8e-5, 4e-6, 12):
        found = diagnose(record(seed=31, fault=_asymmetry(float(size))), DiagnosisOptions(effects=EFFECTS))
        if 0.3 < found.posterior.probability["gyro_scale_asymmetry"] < 0.8:
            return found
    raise AssertionError("no size leaves the question open")


@pytest.mark.slow
def test_the_fastest_turns_are_chosen_for_an_error_that_grows_with_rate(weak: Diagnosis) -> None:
    """An asymmetry of z shows where z turns, and the more the faster: no segment at rest tells anything of it."""
    found = _proposed(weak, _options())
    assert found is not None
    assert found.probability > found.now
    assert len(found.segments) >= FEWEST
    turning = [s for s in found.segments if isinstance(s.motion, Spin) and abs(s.motion.rate) > 80 * DEG]
    assert len(turning) >= len(found.segments) / 2
    assert found.seconds == pytest.approx(50.0 * len(found.segments))


def test_a_soak_before_the_first_segment_makes_no_long_one_better(weak: Diagnosis) -> None:
    """Half an hour that every first segment takes, but a recorded ramp, which tells little for its length."""
    options = _options()
    ramp = Segment(len(options), "ramp", np.eye(3), "", Rest(), 750.0, ramp_to=323.15)
    plain, soaked = _proposed(weak, [*options, ramp]), _proposed(weak, [*options, ramp], 1800.0)
    assert plain is not None and soaked is not None
    assert [s.label for s in soaked.segments] == [s.label for s in plain.segments]
    assert soaked.seconds == plain.seconds + 1800.0


def test_where_nothing_helps_that_is_said(weak: Diagnosis) -> None:
    """Segments at rest cannot tell a scale error from none, however many."""
    found = _proposed(weak, _options(rates=()))
    assert found is None or not found.segments or found.probability < 0.9


def test_a_second_triad_of_gyros_without_declared_noise_is_as_noisy_as_the_first() -> None:
    """Without noise, a proposed instrument would give infinite information, and numpy would warn."""
    whole = record(seed=31)
    channels = tuple(replace(channel, white=0.0) for channel in whole.channels)
    weighing = diagnose(replace(whole, channels=channels), DiagnosisOptions(effects=("gyro_warm_up",))).grounds.weighing
    second = [channel for one in _instruments(weighing) for channel in one.channels]
    assert [channel.white for channel in second] == pytest.approx([GYRO_WHITE] * 3, rel=0.1)


def test_nothing_is_proposed_where_nothing_is_open() -> None:
    def unbalance(o: Observed, omega: Array, force: Array, d: np.random.Generator) -> tuple[Array, float]:
        return force / G @ np.array([[0, 3, 0], [-2, 0, 1], [0, 1, 0]]) * 1e-3 * DEG, 0.0

    found = diagnose(record(seed=32, fault=unbalance), DiagnosisOptions(effects=EFFECTS))
    assert _proposed(found, _options()) is None
