"""Explanations that physics excludes, and effects that cannot be fitted."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.error_model.effects.interface import effect_named
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.gap.answer.sets import sets_of
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import candidates_of
from planrunner.observation.refusals import ObservationError
from planrunner.physics.earth import Site
from tests.gap.turntable import Fault, kept, record

AXIS = np.array([0.0, 0.0, 1.0])
EFFECTS = ("lever_arm", "accel_second_order", "table_tilt")


def arm(metres: float, about: float = 1.0) -> Fault:
    """Accelerometers away from the axis: centripetal and tangential acceleration, turned into the sensor by its attitude. about: share."""

    def fault(
        seen: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator
    ) -> tuple[float, np.ndarray]:
        axis = np.einsum("nij,j->ni", seen.attitude[seen.owner], AXIS)
        place = metres * np.array([0.6, 0.0, 0.8])
        turn, spin = seen.rate[:, None] * axis, seen.acceleration[:, None] * axis
        return 0.0, about * (np.cross(turn, np.cross(turn, place)) + np.cross(spin, place))

    return fault


def test_a_lever_arm_on_the_table_is_named() -> None:
    found = diagnose(record(seed=5, fault=arm(0.05)), DiagnosisOptions(effects=EFFECTS))
    assert found.verdict.effects == ("lever_arm",)
    assert {p.name: round(p.value) for p in found.parameters}["r_z"] == pytest.approx(40, abs=2)


def test_a_lever_arm_longer_than_any_table_is_not_named() -> None:
    found = diagnose(record(seed=5, fault=arm(2.3)), DiagnosisOptions(effects=EFFECTS))
    assert "lever_arm" not in found.verdict.effects and found.verdict.kind != "none"
    assert sum(p for name, p in found.posterior.probability.items() if "lever_arm" in name) < 0.01


def test_a_gap_that_no_candidate_can_show_is_unknown() -> None:
    assert diagnose(record(seed=5, fault=arm(0.3)), DiagnosisOptions(effects=())).verdict.kind == "unknown"


def test_a_lever_arm_longer_than_the_declared_reach_is_not_named() -> None:
    seen = record(seed=5, fault=arm(0.3))
    assert "lever_arm" in diagnose(seen, DiagnosisOptions(effects=EFFECTS)).verdict.effects
    assert "lever_arm" not in diagnose(replace(seen, reach=0.1), DiagnosisOptions(effects=EFFECTS)).verdict.effects


def test_a_fold_over_is_only_given_with_its_limit() -> None:
    with pytest.raises(ObservationError, match="gyro_fold_over can only be given with its values") as raised:
        diagnose(record(seed=5), DiagnosisOptions(effects=("gyro_warm_up",), given=("gyro_fold_over",)))
    assert "limit" in raised.value.hint


def opposite(
    seen: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator
) -> tuple[np.ndarray, float]:
    """The opposite of a dead zone of 3 deg/s: small rates appear too large."""
    return np.copysign(np.sqrt(omega**2 + np.deg2rad(3.0) ** 2), omega) - omega, 0.0


def early(seen: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator) -> tuple[np.ndarray, float]:
    """Outputs that lead the rate by 5 ms, the opposite of a lag and of a delay."""
    axis = np.einsum("nij,j->ni", seen.attitude[seen.owner], AXIS)
    return 5e-3 * seen.acceleration[:, None] * axis, 0.0


def uneven(seen: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator) -> tuple[np.ndarray, float]:
    """A rate that rises from a tenth of its mean to almost twice its mean in each turn, as of a hand that starts and stops."""
    axis = np.einsum("nij,j->ni", seen.attitude[seen.owner], AXIS)
    return -0.9 * (np.cos(seen.angle) * seen.rate)[:, None] * axis, 0.0


@pytest.mark.parametrize(
    ("fault", "effect"), [(opposite, "gyro_dead_zone"), (early, "gyro_bandwidth"), (uneven, "table_rate_ripple")]
)
def test_what_an_effect_cannot_be_is_not_named(fault: Fault, effect: str) -> None:
    found = diagnose(record(seed=5, fault=fault), DiagnosisOptions(effects=(effect,)))
    assert effect not in found.verdict.effects and found.verdict.kind == "unknown"
    assert sum(p for name, p in found.posterior.probability.items() if effect in name) < 0.01


def test_the_quick_evidence_of_a_pair_respects_the_physical_limits() -> None:
    """An output that grows faster than the rate is the opposite of a saturation, also beside a further effect."""

    def steeper(
        seen: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator
    ) -> tuple[np.ndarray, float]:
        return 0.02 * omega**3, 0.0

    weighing = Weighing(record(seed=5, fault=steeper))
    effects = [effect_named(name) for name in ("gyro_scale_asymmetry", "gyro_soft_saturation")]
    sets = sets_of(weighing, candidates_of(weighing, effects), lambda size: -4.0 * size, walks=False)
    key = "gyro_scale_asymmetry+gyro_soft_saturation"
    assert sets.full[key].weighed.excluded
    assert sets.quick[key] < 0


def test_a_delay_may_have_either_sign() -> None:
    found = diagnose(record(seed=5, fault=early), DiagnosisOptions(effects=("gyro_bandwidth", "time_latency")))
    assert found.verdict.effects == ("time_latency",)


def elsewhere(latitude: float) -> Fault:
    """The rate of the Earth at another latitude, in degrees; beyond 90, no place on the Earth."""

    def fault(
        seen: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator
    ) -> tuple[np.ndarray, float]:
        phi, assumed = np.deg2rad(latitude), seen.site.latitude
        change = np.array([0.0, np.cos(phi) - np.cos(assumed), np.sin(phi) - np.sin(assumed)])
        change *= np.deg2rad(15.041067 / 3600)
        back = Rotation.from_rotvec(-seen.angle[:, None] * AXIS).apply(change)
        return np.einsum("nij,nj->ni", seen.attitude[seen.owner], back), 0.0

    return fault


@pytest.mark.parametrize("latitude", [-70.0, 85.0])
def test_another_latitude_is_named(latitude: float) -> None:
    seen = record(seed=5, fault=elsewhere(latitude))
    found = diagnose(seen, DiagnosisOptions(effects=("site_latitude", "gyro_g_sensitivity")))
    assert found.verdict.effects == ("site_latitude",)
    (error,) = found.parameters
    assert np.rad2deg(seen.site.latitude) + error.value == pytest.approx(latitude, abs=4 * error.standard_uncertainty)


def test_a_latitude_of_the_other_hemisphere_is_named_where_only_the_vertical_rate_shows_it() -> None:
    """For a small angle, the vertical rate would require an error beyond the pole. The exact error is possible."""
    whole = kept(record(seed=5), [2, 4])  # x down, x up; y north in both
    edges = np.concatenate([np.linspace(a, b, 4)[:-1] for a, b in pairwise(whole.bounds)] + [whole.bounds[-1:]])
    twice = np.repeat([0, 1], 3)
    cut = replace(
        whole,
        labels=tuple(f"part_{k}" for k in range(6)),
        motions=tuple(whole.motions[k] for k in twice),
        attitude=whole.attitude[twice],
        last_change=whole.last_change[twice],
        bounds=np.round(edges).astype(np.int64),
        site=Site(np.radians(-60.0), whole.site.gravity),
    )
    nominal = ("gyro_bias", "earth_rate", "accel_bias", "accel_scale_factor", "accel_misalignment")
    found = diagnose(cut, DiagnosisOptions(nominal, effects=("site_latitude", "gyro_warm_up")))
    assert found.verdict.effects == ("site_latitude",)
    (error,) = found.parameters
    assert error.value == pytest.approx(99.98, abs=4 * error.standard_uncertainty)


@pytest.mark.parametrize(
    ("latitude", "effects"), [(-130.0, ("site_latitude", "gyro_g_sensitivity")), (120.0, ("site_latitude",))]
)
def test_a_latitude_beyond_a_pole_is_not_named(latitude: float, effects: tuple[str, ...]) -> None:
    found = diagnose(record(seed=5, fault=elsewhere(latitude)), DiagnosisOptions(effects=effects))
    assert "site_latitude" not in found.verdict.effects and found.verdict.kind != "none"
    assert sum(p for name, p in found.posterior.probability.items() if "site_latitude" in name) < 0.01


def test_an_effect_that_no_possible_amplitude_makes_visible_is_no_hypothesis() -> None:
    """Within the noise of this recording, a lever arm shows from about a millimetre on; the table allows 1 µm, or 0.3 m."""
    effects = [effect_named("lever_arm")]
    for reach, visible in ((1e-6, False), (0.3, True)):
        (found,) = candidates_of(Weighing(replace(record(seed=5), reach=reach)), effects)
        assert bool(np.isfinite(found.log_bayes).any()) is visible
