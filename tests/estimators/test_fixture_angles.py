"""Angles of a fixture from spins in several orientations: truth by hand formulas, what identifies them, and their use for scale factors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorded import noisy, segment, sensor
from tilted_recording import DEG, EARTH, SITE, THETA, Gyro, estimate, plan_mounting, sampled, series, turned_label

from planrunner.archive.recording import RecordedSegment
from planrunner.design.identifiability import identify
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, EstimationError, Setup
from planrunner.estimators.method import designed
from planrunner.estimators.tilted.fixture_angles import FixtureAngles, FixtureAnglesParameters
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.plan.schedule import Spin
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.influences import InputQuantity, Inputs

# Rows are the fixture's x, y and z axes in East-North-Up.
Z_UP = np.eye(3)
X_UP = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
Y_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
Z_DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
STATED = {"x": (THETA, 0.0), "y": (THETA, 120.0), "z": (THETA, 240.0)}
TRUE = {"x": (54.7427, 0.004), "y": (54.7301, 119.993), "z": (54.7389, 240.009)}
GYROS = {"x": Gyro(1.0002, bias=1e-4), "y": Gyro(0.9997), "z": Gyro(1.0001)}
RATES = (100.0, -100.0, 50.0, -50.0)


def direction(angle: float, azimuth: float) -> np.ndarray:
    a, b = angle * DEG, azimuth * DEG
    return np.array([math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)])


def tilted_about_x(degrees: float) -> np.ndarray:
    """The fixture turned about its x axis, which stays east."""
    c, s = math.cos(degrees * DEG), math.sin(degrees * DEG)
    return np.array([[1.0, 0, 0], [0, c, s], [0, -s, c]])


def spins(
    orientations: Sequence[np.ndarray],
    true: dict = TRUE,
    noise: np.random.Generator | None = None,
    sigma: float = 0.0,
    skew: np.ndarray | None = None,
    rate_error: dict[float, float] | None = None,
) -> list[RecordedSegment]:
    """Whole turns about up: an axis along d sees (d·up)·(ω + Ω·sin φ). skew: small rotations of the fixture (orientations, 3). With
    `noise`, samples, whose means scatter by `sigma`, deg/s."""
    up, made = np.array([0.0, 0, 1]), []
    for place, attitude in enumerate(orientations):
        for rate in RATES:
            seconds = 36.0
            spinning = segment(f"O{place}/R{rate:+g}", attitude, Spin(rate * DEG), seconds)
            planned = replace(spinning, orientation=f"O{place}")
            means = {}
            for axis, (angle, azimuth) in true.items():
                d = direction(angle, azimuth)
                if skew is not None:
                    d = d + np.cross(skew[place], d)
                real = rate * (1 + (rate_error or {}).get(rate, 0.0))
                felt = float(d @ (attitude @ up)) * (real + EARTH * math.sin(40 * DEG) / 3600)
                value = GYROS[axis].K * felt + GYROS[axis].bias + 0.01 * place  # a bias that depends on gravity
                means[f"gyro_{axis}"] = value
            made.append(noisy(planned, means, "deg/s", sigma, noise, samples=360) if noise else sampled(planned, means))
    return made


def found(
    recorded: Sequence[RecordedSegment], stated: dict | None = None, inputs: Inputs | None = None, **keys: Any
) -> Estimate:
    axes = stated or STATED
    setup = Setup(None, plan_mounting(axes), inputs or Inputs())
    model = sensor(*(f"gyro_{name}" for name in axes), unit="deg/s")
    request = EstimateRequest("fixture", tuple(recorded), FixtureAnglesParameters(**keys), SITE, model, setup=setup)
    return combined(FixtureAngles().estimate(request))


@pytest.mark.parametrize("orientations", [[Z_UP, X_UP, Y_UP], [Z_UP, tilted_about_x(40.0), X_UP], [X_UP, Y_UP, Z_DOWN]])
def test_three_directions_give_angle_azimuth_and_scale_factor(orientations: list[np.ndarray]) -> None:
    result = found(spins(orientations))
    for name, (angle, azimuth) in TRUE.items():
        assert result[f"angle_{name}"].value == pytest.approx(angle, abs=1e-10)
        assert result[f"azimuth_{name}"].value == pytest.approx(azimuth, abs=1e-9)
        assert result[f"K_{name}"].value == pytest.approx(GYROS[name].K, rel=1e-12)


def test_two_directions_give_the_angle_where_the_azimuth_is_stated() -> None:
    """Also the second mounting in which an axis lies along the rotation axis: its rate is then K alone."""
    stated = {name: (THETA, azimuth) for name, (_, azimuth) in TRUE.items()}
    along_z = direction(*stated["z"])
    across = np.cross([0.0, 0, 1], along_z)
    along_x = np.column_stack(
        [across / np.linalg.norm(across), np.cross(along_z, across / np.linalg.norm(across)), along_z]
    )
    for second in (X_UP, along_x):
        result = found(spins([Z_UP, second]), stated, azimuth="stated")
        for name, (angle, _) in TRUE.items():
            assert result[f"angle_{name}"].value == pytest.approx(angle, abs=1e-9)
            assert result[f"K_{name}"].value == pytest.approx(GYROS[name].K, rel=1e-11)


@pytest.mark.parametrize(
    ("orientations", "azimuth", "sound"),
    [
        ([Z_UP, X_UP, Y_UP], "fitted", True),
        ([Z_UP, X_UP], "fitted", False),
        ([Z_UP, X_UP], "stated", True),
        ([Z_UP, Z_DOWN], "stated", False),
        ([Z_UP], "stated", False),
    ],
    ids=["three", "two, azimuth fitted", "two, azimuth stated", "upside down", "one"],
)
def test_check_refuses_mountings_that_do_not_determine_the_angles(
    orientations: list[np.ndarray], azimuth: str, sound: bool
) -> None:
    outputs = tuple(OutputModel(f"gyro_{name}", "deg/s", noise=NoiseModel(1e-4)) for name in STATED)
    planned = tuple(one.segment for one in spins(orientations))
    request = DesignRequest(
        "fixture",
        planned,
        FixtureAnglesParameters(azimuth=azimuth),
        SITE,
        SensorModel("gyro-triad", outputs, 10.0),
        setup=Setup(None, plan_mounting(STATED)),
    )
    design = designed(FixtureAngles(), request)
    assert all(judged.sound is sound for judged in identify(design))
    assert bool(design.remarks) is not sound
    assert bool(design.predicted) is sound
    if not sound:
        with pytest.raises(EstimationError, match="cannot separate all terms"):
            found(spins(orientations), azimuth=azimuth)


def test_predicted_and_propagated_uncertainty_by_hand() -> None:
    """An axis at θ in z-up and x-up, azimuth 0: gains a = K·sin θ, c = K·cos θ of equal u give u(θ) = u/K and u(K) = u."""
    axes = {"x": (THETA, 0.0)}
    rng = np.random.default_rng(3)
    results = [
        found(spins([Z_UP, X_UP], axes, rng, 1e-5), axes, azimuth="stated", uncertainty="within_segment")
        for _ in range(20)
    ]
    u = 1e-5 / math.sqrt(sum(rate**2 for rate in RATES))
    for name, unit, expected in (("angle_x", DEG, u / 1.0002), ("K_x", 1.0, u)):
        stated = math.sqrt(np.mean([(unit * one[name].standard_uncertainty) ** 2 for one in results]))
        assert stated == pytest.approx(expected, rel=0.04)  # 20 × 8 × 31 degrees of freedom: 1 %
        scatter = np.std([unit * one[name].value for one in results], ddof=1)
        assert scatter == pytest.approx(expected, rel=0.5)  # 20 values: 16 %


def test_what_all_rates_share_cancels_in_the_angles_and_positions_do_not() -> None:
    held = {
        name: InputQuantity(name, 0.0, unit, u)
        for name, unit, u in (("table position", "rad", 1e-5), ("table rate", "1", 1e-5))
    }
    result = found(spins([Z_UP, X_UP, Y_UP]), inputs=Inputs(held))
    lines = {
        line.quantity: line for budget in result.budgets if budget.coefficient == "angle_x" for line in budget.lines
    }
    shared = lines["table rate"].contribution if "table rate" in lines else 0.0
    assert shared < 1e-4 * lines["table position"].contribution
    # Against brute force: each orientation skewed about each axis of the fixture.
    columns = []
    for place in range(3):
        for axis in range(3):
            skew = np.zeros((3, 3))
            skew[place, axis] = 1e-5
            columns.append(found(spins([Z_UP, X_UP, Y_UP], skew=skew))["angle_x"].value - TRUE["x"][0])
    assert lines["table position"].contribution == pytest.approx(math.sqrt(sum(c**2 for c in columns)), rel=1e-3)


def test_scale_factors_use_the_calibrated_angles_with_their_uncertainty() -> None:
    rng = np.random.default_rng(5)
    held = Inputs({"table position": InputQuantity("table position", 0.0, "rad", 1e-5)})
    calibrated = found(spins([Z_UP, X_UP, Y_UP], noise=rng, sigma=1e-6), inputs=held)
    recorded = series(TRUE, GYROS)
    plain = estimate(recorded, STATED)
    better = estimate(recorded, STATED, uses={"fixture": calibrated})
    for name in TRUE:
        assert abs(plain[f"K_{name}"].value / GYROS[name].K - 1) > 50e-6
        item = better[f"K_{name}"]
        assert item.value == pytest.approx(GYROS[name].K, rel=2e-6)
        by_angle = math.tan(TRUE[name][0] * DEG) * calibrated[f"angle_{name}"].standard_uncertainty * DEG
        assert item.standard_uncertainty == pytest.approx(by_angle, rel=0.02)
    with pytest.raises(EstimationError, match="'other' has no coefficient 'angle_x'"):
        estimate(recorded, STATED, uses={"other": plain})


@pytest.mark.parametrize("about", [0, 1])
def test_a_skew_of_home_acts_on_calibration_and_scale_factor_as_one_input(about: int) -> None:
    """Against brute force: the fixture skewed at home in both recordings moves K by the sum of both sensitivities, no root sum."""
    held = Inputs({"table position": InputQuantity("table position", 0.0, "rad", 1e-5)})

    def scale_factor(size: float) -> Estimate:
        skew = np.zeros((3, 3))
        skew[0, about] = size
        at_home = {}
        for name, where in TRUE.items():
            d = direction(*where) + np.cross(skew[0], direction(*where))
            at_home[name] = (
                math.degrees(math.atan2(math.hypot(d[0], d[1]), d[2])),
                math.degrees(math.atan2(d[1], d[0])),
            )
        calibrated = found(spins([Z_UP, X_UP, Y_UP], skew=skew), inputs=held)
        recorded = [turned_label(one, orientation="O0") for one in series(at_home, GYROS)]
        return estimate(recorded, STATED, held, uses={"fixture": calibrated})

    plain = scale_factor(0.0)
    moved = [scale_factor(1e-5)[f"K_{name}"].value - plain[f"K_{name}"].value for name in TRUE]
    (position,) = (one for one in merged(plain.influences) if one.quantity.name == "table position")
    column = position.sensitivities[:, position.parts.index(f"O0, about {'xy'[about]}")]
    names = [item.name for item in plain.coefficients]
    expected = [-1e-5 * column[names.index(f"K_{name}")] for name in TRUE]
    assert moved == pytest.approx(expected, rel=1e-3, abs=1e-10)


def test_refusals() -> None:
    with pytest.raises(EstimationError, match="parallel to the fixture's z axis"):
        found(spins([Z_UP, X_UP, Y_UP], {"x": (0.0, 0.0)}), {"x": (0.0, 0.0)})
    with pytest.raises(EstimationError, match=r"mounting\.x states no azimuth"):
        found(spins([Z_UP, X_UP]), {"x": (THETA, None)}, azimuth="stated")
    unknown = spins([Z_UP, X_UP, Y_UP])
    with pytest.raises(EstimationError, match="orientation of segment 'O0/R"):
        found([turned_label(unknown[0], attitude=None), *unknown[1:]])
