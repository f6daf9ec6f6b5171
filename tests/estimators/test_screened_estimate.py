"""Bad samples and estimates: left out, used or refused as the plan says, and named with what they change.

The recordings come from `tests.worlds`, which shares no code with planrunner.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_samples, segment, sensor

from planrunner.estimators.analysis import analyse
from planrunner.estimators.interface import Estimate
from planrunner.estimators.scale_factor import ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Spin
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded
from tests.worlds.faults import WORLDS

CLEAN = WORLDS["white noise"]


ROCKING = "rocking_drift"
EACH = [name for name in CAMPAIGNS if not name.startswith(ROCKING)]


def made(estimator: str, fault: bool, outliers: str = "exclude") -> Estimate | str:
    campaign = CAMPAIGNS[estimator]
    sound = known(campaign, CLEAN)
    estimates = {name: replace(spec, outliers=outliers) for name, spec in sound.plan.estimates.items()}
    _, data = recorded(campaign, CLEAN, np.random.default_rng(8))
    values = data.values.copy()
    if fault:
        row = np.searchsorted(data.time, data.time[data.step == 1][0] + 61.0) if estimator == ROCKING else 1000
        values[row, 0] += 1000 * data.white[0]
    sound = replace(sound, plan=replace(sound.plan, estimates=estimates))
    return estimated(campaign, sound, replace(data, values=values))


LONG = (ROCKING, "strapdown_navigation at rest")


@pytest.mark.parametrize(
    "estimator",
    [
        *(name for name in EACH if name not in LONG),
        *(pytest.param(name, marks=pytest.mark.slow) for name in LONG),
    ],
)
def test_one_bad_sample_moves_no_coefficient_by_a_tenth_of_its_uncertainty(estimator: str) -> None:
    """Of a platform: a sample in the first window of a run."""
    clean, spiked = made(estimator, False), made(estimator, True)
    assert not isinstance(clean, str) and not isinstance(spiked, str)
    for item in clean.coefficients:
        assert abs(spiked[item.name].value - item.value) <= 0.1 * item.standard_uncertainty, item.name
        assert spiked[item.name].standard_uncertainty == pytest.approx(item.standard_uncertainty, rel=0.02)
    (warning,) = [text for text in spiked.warnings if "Bad samples were left out" in text]
    assert "spike" in warning and not [text for text in clean.warnings if "samples" in text]
    assert {"Screening of the samples", "Coefficients with and without bad samples"} <= {
        table.title for table in spiked.tables
    }


def test_kept_samples_are_used_and_named() -> None:
    kept, clean = made("flexure_gyro_static", True, "keep"), made("flexure_gyro_static", False)
    assert not isinstance(kept, str) and not isinstance(clean, str)
    assert abs(kept["D_X_F"].value - clean["D_X_F"].value) > 0.1 * clean["D_X_F"].standard_uncertainty
    assert any("Bad samples were used" in text for text in kept.warnings)


def test_refused_samples_give_no_estimate_and_the_reason() -> None:
    message = made("flexure_gyro_static", True, "refuse")
    assert isinstance(message, str) and "spike of torquer_x in 'P1'" in message
    assert isinstance(made("flexure_gyro_static", False, "refuse"), Estimate)


@pytest.mark.slow
@pytest.mark.parametrize(
    "estimator", [ROCKING, "strapdown_navigation at rest", "strapdown_navigation from stop to stop"]
)
def test_a_stuck_second_of_all_channels_is_named_and_moves_nothing_or_is_said_to_be_left_in(estimator: str) -> None:
    """A burst with which a record begins, or that comes while the table turns, may be motion and is left in."""
    campaign = CAMPAIGNS[estimator]
    sound = known(campaign, CLEAN)
    for run in range(4):
        clean, stuck = (
            estimated(campaign, sound, recorded(campaign, world, np.random.default_rng([1, run]))[1])
            for world in (CLEAN, WORLDS["stuck for a second"])
        )
        assert isinstance(clean, Estimate) and isinstance(stuck, Estimate)
        moved = [abs(stuck[one.name].value - one.value) / one.standard_uncertainty for one in clean.coefficients]
        words = ("samples were left out", "but left out no samples")
        left_out, left_in = (any(one in text for text in stuck.warnings) for one in words)
        assert left_in or (left_out and max(moved) <= 0.1)


def test_bad_samples_of_other_outputs_do_not_concern_an_estimate() -> None:
    """Two gyros in one recording, an estimate for each. A spike of the one is no reason to refuse the other."""
    draw = np.random.default_rng(21)
    recording = []
    for number, rate in enumerate((10.0, -10.0, 40.0, -40.0, 80.0, -80.0)):
        time = 40.0 * number + np.arange(3000) / 100
        values = {name: 200.0 * rate + 3.0 + 0.5 * draw.standard_normal(3000) for name in ("first", "second")}
        if number == 2:
            values["second"][1500] += 500.0
        planned = segment(f"R{number}", np.eye(3), Spin(math.radians(rate), (0.0, 0.0, 1.0)), 30.0)
        recording.append(from_samples(planned, time, values, dict.fromkeys(values, "pulse/s")))
    estimates = {
        name: EstimateSpec(
            estimator="scale_factor", outliers="refuse", parameters=ScaleFactorParameters(outputs=(name,))
        )
        for name in ("first", "second")
    }
    results = analyse(estimates, (), recording, Site(math.radians(47.0)), sensor("first", "second"))
    assert list(results.estimates) == ["first"]
    assert "the plan refuses them: spike of second in 'R2' at 95 s (" in results.failures["second"]
    assert not [text for text in results.estimates["first"].warnings if "second" in text]
