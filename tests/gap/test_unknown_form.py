"""The form of a cause outside the catalogue: what it follows, where, and how much of the gap it takes."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions, diagnose
from planrunner.gap.hypotheses.patterns import Factor
from planrunner.plan.schedule import Spin
from planrunner.reporting.diagnosis_page import tables, unknown_words
from tests.gap.turntable import DEG, record

Array = np.ndarray
SIZE = 0.02  # m/s²
FEW = ("accel_bias_step", "accel_bias_temperature", "lever_arm", "mount_shift", "table_wobble")


@pytest.fixture(
    scope="module",
    params=[pytest.param(FEW, id="few"), pytest.param(None, marks=pytest.mark.slow, id="all")],
)
def options(request: pytest.FixtureRequest) -> DiagnosisOptions:
    """A few effects, or all of them, which takes long."""
    return DiagnosisOptions(effects=request.param)


@pytest.fixture(scope="module")
def resonating(options: DiagnosisOptions) -> Diagnosis:
    """A mount that resonates while the table turns at 40 deg/s, about any axis and in both directions, and shifts one accelerometer."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[float, Array]:
        fast = np.array([isinstance(m, Spin) and abs(abs(m.rate) - 40 * DEG) < 1e-9 for m in observed.motions])
        return 0.0, SIZE * fast[observed.owner][:, None] * np.array([0.0, 0.0, 1.0])

    return diagnose(record(5, fault), options)


def test_the_pattern_that_explains_an_unknown_gap_is_said(resonating: Diagnosis) -> None:
    assert resonating.verdict.kind == "unknown"
    found = resonating.unknown
    assert found is not None
    assert (found.factor, found.channels) == (Factor.RATE, ("accel_z",))
    assert found.share is not None and found.share > 0.9
    values = {point.level: point.values[0] for point in found.points}
    others = [value for level, value in values.items() if level not in ("40 deg/s", "-40 deg/s")]
    # The fitted bias takes a part of the offset from every level; the difference stays.
    for level in ("40 deg/s", "-40 deg/s"):
        assert values[level] - np.mean(others) == pytest.approx(SIZE, rel=0.2)


def test_it_is_written_drawn_and_listed(resonating: Diagnosis) -> None:
    plain = resonating.to_json()
    assert "accel_z" in unknown_words(plain) and "rate" in unknown_words(plain)
    rows = tables(plain)["unknown_form"].rows
    assert {str(row[0]) for row in rows} >= {"40 deg/s", "-40 deg/s", "rocking"}


def test_without_an_unknown_cause_nothing_is_said(options: DiagnosisOptions) -> None:
    found = diagnose(record(3), options)
    assert found.unknown is None and unknown_words(found.to_json()) == ""
