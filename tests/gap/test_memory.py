"""The memory of a diagnosis grows in proportion to the number of segments. Each segment adds coefficients, and each segment also adds
moments at which a step may occur, so a table of all coefficients of all steps would grow with the square of this number."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from planrunner.error_model.effects.interface import Column
from planrunner.gap.answer.diagnosis import hypotheses
from planrunner.gap.evidence.weighing import inner_products, table_of
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import candidates_of
from tests.gap.turntable import record

EFFECTS = ("gyro_bias_step", "accel_bias_step", "mount_shift", "gyro_g_sensitivity", "gyro_saturation", "gyro_warm_up")


def stored(repeats: int) -> tuple[int, int, int]:
    """Bytes of the prepared recording and of the evaluated effects, and the number of coefficients of a channel, if the plan is
    repeated."""
    observed = record(seed=4, sampling=4.0, repeats=repeats)
    effects = hypotheses(EFFECTS)
    tracemalloc.start()
    weighing = Weighing(observed)
    prepared, _ = tracemalloc.get_traced_memory()
    candidates = candidates_of(weighing, effects)
    both, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(candidates) == len(EFFECTS)
    return prepared, both - prepared, len(weighing.spectrum.segment)


def test_the_memory_grows_linearly_with_the_segments() -> None:
    """41 and 164 segments. The prepared recording contains one matrix of the segment means for each level of a random walk, of each
    gyro; all other stored numbers grow linearly."""
    stored(1)  # loads everything that is loaded only once
    few, many = stored(1), stored(4)
    assert many[2] == 4 * few[2]
    assert many[1] < 5 * few[1]
    matrices = [8 * 3 * 13 * segments**2 for segments in (41, 164)]
    assert many[0] - 4 * few[0] < 1.5 * (matrices[1] - 4 * matrices[0])


def test_steps_share_their_coefficients() -> None:
    """All moments of a step at the boundaries of segments have the same coefficients, in a different number of segments."""
    weighing = Weighing(record(seed=4, sampling=4.0))
    (candidate,) = candidates_of(weighing, hypotheses(["gyro_bias_step"]))
    parts = [own for form in candidate.variants for column in form.variant.columns for own in column.parts.values()]
    assert len(parts) > 3 * 40
    assert (
        len({id(own) for own in parts}) <= 9
    )  # at the boundaries, and in the middles of the first and the last segment


def test_inner_products_by_segments_are_those_of_the_tables() -> None:
    draw = np.random.default_rng(6)
    segment, means = np.repeat([0, 1, 2], [2, 4, 3]), np.array([0, 2, 6])
    one, two, three = draw.standard_normal((3, 9))
    some = [np.array(mask) for mask in ([False, True, True], [True, False, True])]
    columns = [
        Column("a", "1", 1.0, 2.0, {0: one, 2: two}, some[0], axis=None),
        Column("b", "1", 1.0, 0.5, {1: three}, axis=None),
        Column("c", "1", 1.0, 3.0, {0: one, 2: two}, some[1], axis=None),
        Column("d", "1", 1.0, 1.0, {3: one}, axis=None),
    ]
    others = {channel: draw.standard_normal((9, 2)) for channel in range(3)}
    expected = np.sum([own.T @ table_of(columns, channel, segment) for channel, own in others.items()], axis=0)
    assert inner_products(columns, others, means) == pytest.approx(expected)
    assert not expected[:, 3].any()
