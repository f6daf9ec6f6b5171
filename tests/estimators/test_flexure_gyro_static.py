"""The eight positions: coefficients chosen, pulses from a formula written apart, recovered; weights, bases and refusals."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from recorded import from_means, noisy, segment, sensor

from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, EstimationError
from planrunner.estimators.method import designed
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Spin
from tests.directions import WORDS

SITE = Site(math.radians(39.98), 9.8015)
OPTIMAL = {
    "P1": "up north west",
    "P2": "down north east",
    "P3": "north up east",
    "P4": "north down west",
    "P5": "east south down",
    "P6": "south east up",
    "P7": "west south up",
    "P8": "south west down",
}
DRIFTS = [f"D_{axis}_{kind}" for axis, kind in itertools.product("XY", "FXYZ")]
TRUTH = {"SF_X": 0.031, "SF_Y": 0.029, "epsilon": 47.0, "xi": -31.0} | dict(
    zip(DRIFTS, [1.2, -0.8, 3.1, 0.4, -2.2, 2.7, 0.9, -0.3], strict=True)
)
CHANNELS = ("torquer_x", "torquer_y")


def attitude(words: str) -> np.ndarray:
    return np.array([WORDS[word] for word in words.split()], dtype=float)


def pulses(
    axes: np.ndarray, truth: dict[str, float] = TRUTH, products: dict[str, float] | None = None
) -> tuple[float, float]:
    """Both outputs [pulse/s], from the source's formulas in deg/h, g and radians; nothing of planrunner's physics is used."""
    earth = (0.0, 15.041067 * math.cos(SITE.latitude), 15.041067 * math.sin(SITE.latitude))
    w = [sum(a * b for a, b in zip(axis, earth, strict=True)) for axis in axes]
    a = [axis[2] * 9.8015 / 9.80665 for axis in axes]
    seen_y = w[1] + truth["D_X_F"] + truth["D_X_X"] * a[0] + truth["D_X_Y"] * a[1] + truth["D_X_Z"] * a[2]
    seen_x = w[0] + truth["D_Y_F"] + truth["D_Y_X"] * a[0] + truth["D_Y_Y"] * a[1] + truth["D_Y_Z"] * a[2]
    for name, value in (products or {}).items():
        product = a[0] * a[2] if name.endswith("XZ") else a[1] * a[2]
        if name.startswith("D_X"):
            seen_y += value * product
        else:
            seen_x += value * product
    e, x = math.radians(truth["epsilon"] / 60), math.radians(truth["xi"] / 60)
    return (
        (math.cos(e + x) * seen_y + math.sin(e + x) * seen_x) / (truth["SF_Y"] * math.cos(x)),
        (-math.sin(e) * seen_y + math.cos(e) * seen_x) / (truth["SF_X"] * math.cos(x)),
    )


def estimate(
    noise: np.ndarray | float = 0.0, error: float = 0.0, positions: dict[str, str] = OPTIMAL, **keys: Any
) -> Estimate:
    rows = np.broadcast_to(np.asarray(noise, dtype=float), (len(positions), 2))
    recorded = tuple(
        from_means(
            segment(label, attitude(words)),
            dict(zip(CHANNELS, np.add(pulses(attitude(words)), row), strict=True)),
            "pulse/s",
            error,
        )
        for (label, words), row in zip(positions.items(), rows, strict=True)
    )
    request = EstimateRequest("drift", recorded, FlexureGyroStaticParameters(**keys), SITE, sensor(*CHANNELS))
    return FlexureGyroStatic().estimate(request)


def test_recovered_without_noise() -> None:
    found = estimate()
    assert found.headline == ("SF_X", "SF_Y", "epsilon", "xi", *DRIFTS)
    for name, value in TRUTH.items():
        assert found[name].value == pytest.approx(value, rel=1e-9)
    assert [found[name].unit for name in ("SF_X", "xi", "D_X_F", "D_Y_Z", "U0", "V1", "U5")] == [
        "(deg/h)/(pulse/s)",
        "arcmin",
        "deg/h",
        "deg/h/g",
        "pulse/s",
        "(pulse/s)/(deg/h)",
        "(pulse/s)/g",
    ]
    e, x = math.radians(47 / 60), math.radians(-31 / 60)
    assert found["U1"].value == pytest.approx(math.cos(e + x) / (0.029 * math.cos(x)), rel=1e-9)
    assert found["V1"].value == pytest.approx(-math.sin(e) / (0.031 * math.cos(x)), rel=1e-9)
    assert any(
        "determinant 706.081" in note and "condition number of the design matrix 2.61" in note for note in found.notes
    )


def test_product_terms_with_up_along_the_corners_of_a_cube() -> None:
    truth = {"D_X_XZ": 0.07, "D_X_YZ": -0.02, "D_Y_XZ": 0.01, "D_Y_YZ": 0.05}
    recorded = []
    for n, corner in enumerate(itertools.product((-1, 1), repeat=3)):
        up = np.array(corner) / math.sqrt(3)
        side = np.cross(up, [0.3, 0.5 + n, 1.0 - n])
        side /= np.linalg.norm(side)
        axes = np.column_stack([side, np.cross(up, side), up])
        values = dict(zip(CHANNELS, pulses(axes, products=truth), strict=True))
        recorded.append(from_means(segment(f"C{n}", axes), values, "pulse/s", 0.01))
    parameters = FlexureGyroStaticParameters(terms=("accel_x_accel_z", "accel_y_accel_z"), uncertainty="within_segment")
    found = FlexureGyroStatic().estimate(EstimateRequest("d", tuple(recorded), parameters, SITE, sensor(*CHANNELS)))
    for name, value in (TRUTH | truth).items():
        assert found[name].value == pytest.approx(value, rel=1e-7)
    assert found["D_X_XZ"].unit == "deg/h/g^2"


def test_product_terms_on_cardinal_positions_are_refused_by_name() -> None:
    with pytest.raises(EstimationError, match="accel_x_accel_z and accel_y_accel_z are zero in every position"):
        estimate(positions=OPTIMAL | {"T": "east north up"}, terms=("accel_x_accel_z", "accel_y_accel_z"))


def test_covariance_against_simulated_experiments() -> None:
    """The full covariance of physical and output coefficients: what 40 recordings of samples state, and the scatter of 20 000 experiments
    that are solved by the source's formulas alone."""
    rng = np.random.default_rng(1)
    sigma = 0.02
    stated = np.mean([from_recording(rng, sigma).covariance for _ in range(40)], axis=0)
    design = np.array([_row(attitude(words)) for words in OPTIMAL.values()])
    clean = np.array([pulses(attitude(words)) for words in OPTIMAL.values()])
    draws = clean + sigma * rng.normal(size=(20_000, 8, 2))
    outputs = np.einsum("pn,rnk->rkp", np.linalg.pinv(design), draws)  # (r, 2, 6) in deg/h and g
    alpha, epsilon = np.arctan2(outputs[:, 0, 2], outputs[:, 0, 1]), np.arctan2(-outputs[:, 1, 1], outputs[:, 1, 2])
    xi = alpha - epsilon
    scale_y = np.cos(alpha) / (outputs[:, 0, 1] * np.cos(xi))
    scale_x = np.cos(epsilon) / (outputs[:, 1, 2] * np.cos(xi))
    drifts = np.linalg.solve(outputs[:, :, 1:3], outputs[:, :, [0, 3, 4, 5]]).reshape(-1, 8)
    minutes = 60 * 180 / math.pi
    simulated = np.column_stack([scale_x, scale_y, epsilon * minutes, xi * minutes, drifts, outputs.reshape(-1, 12)])
    expected = np.cov(simulated.T)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.sqrt(np.diag(stated)) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.03)
    assert np.abs((stated - expected) / size).max() < 0.05  # 40 × 248 degrees of freedom and 20 000 draws


def from_recording(rng: np.random.Generator, sigma: float) -> Estimate:
    """sigma: of each mean, pulse/s."""
    recorded = tuple(
        noisy(
            segment(label, attitude(words)),
            dict(zip(CHANNELS, pulses(attitude(words)), strict=True)),
            "pulse/s",
            sigma,
            rng,
        )
        for label, words in OPTIMAL.items()
    )
    parameters = FlexureGyroStaticParameters(uncertainty="within_segment")
    return FlexureGyroStatic().estimate(EstimateRequest("drift", recorded, parameters, SITE, sensor(*CHANNELS)))


def _row(axes: np.ndarray) -> list[float]:
    earth = 15.041067 * np.array([0.0, math.cos(SITE.latitude), math.sin(SITE.latitude)])
    a = axes[:, 2] * 9.8015 / 9.80665
    return [1.0, float(axes[1] @ earth), float(axes[0] @ earth), *map(float, a)]


def test_residual_basis_by_hand() -> None:
    """The variance factor is the residual sum of squares over two degrees of freedom, and four when pooled."""
    rng = np.random.default_rng(2)
    noise = rng.normal(0, 0.05, (8, 2))
    design = np.array([_row(attitude(words)) for words in OPTIMAL.values()])
    project = np.eye(8) - design @ np.linalg.pinv(design)
    sums = np.einsum("nk,nm,mk->k", noise, project, noise)
    cofactor = np.linalg.inv(design.T @ design)
    separate = estimate(noise, error=0.05, pool_outputs=False)
    assert separate["U0"].standard_uncertainty == pytest.approx(math.sqrt(sums[0] / 2 * cofactor[0, 0]), rel=1e-6)
    assert separate["V0"].standard_uncertainty == pytest.approx(math.sqrt(sums[1] / 2 * cofactor[0, 0]), rel=1e-6)
    assert separate["U0"].degrees_of_freedom == pytest.approx(2)
    assert 2 < separate["xi"].degrees_of_freedom < 4
    pooled = estimate(noise, error=0.05)
    assert pooled["V0"].standard_uncertainty == pytest.approx(math.sqrt(sums.sum() / 4 * cofactor[0, 0]), rel=1e-6)
    assert pooled["V0"].degrees_of_freedom == pytest.approx(4)


def test_welch_satterthwaite_by_hand() -> None:
    """xi = atan(U2/U1) + atan(V1/V2): its variance is the sum of two shares with two degrees of freedom each."""
    found = estimate(np.random.default_rng(4).normal(0, 0.05, (8, 2)), error=0.05, pool_outputs=False)
    names = [item.name for item in found.coefficients]
    share = found["epsilon"].standard_uncertainty ** 2  # epsilon comes from the second output alone
    other = found["xi"].standard_uncertainty ** 2 - share
    cross = found.covariance[names.index("epsilon"), names.index("xi")]
    assert cross == pytest.approx(-share, rel=1e-9)
    assert found["xi"].degrees_of_freedom == pytest.approx(
        (share + other) ** 2 / (share**2 / 2 + other**2 / 2), rel=1e-9
    )


def test_both_bases_are_reported_and_excess_scatter_is_warned_of() -> None:
    quiet = estimate(np.random.default_rng(3).normal(0, 0.01, (8, 2)), error=0.01)
    assert not quiet.warnings
    table = next(table for table in quiet.tables if table.title == "Uncertainties from the data, on each basis")
    assert [column for column in table.headings if column.startswith("u (")] == ["u (residual)", "u (within segment)"]
    loud = estimate(np.random.default_rng(3).normal(0, 0.5, (8, 2)), error=0.01, uncertainty="within_segment")
    assert any("within-segment uncertainties are too small" in warning for warning in loud.warnings)


def test_segments_are_weighted_where_their_noise_differs() -> None:
    recorded = []
    for n, (label, words) in enumerate(OPTIMAL.items()):
        values = dict(zip(CHANNELS, pulses(attitude(words)), strict=True))
        recorded.append(from_means(segment(label, attitude(words)), values, "pulse/s", 1.0 if n == 0 else 0.01))
    parameters = FlexureGyroStaticParameters(uncertainty="within_segment")
    found = FlexureGyroStatic().estimate(EstimateRequest("d", tuple(recorded), parameters, SITE, sensor(*CHANNELS)))
    assert found.settings["weights"] == dict.fromkeys(CHANNELS, "the noise level of each segment")
    assert any("weighted by its own" in note for note in found.notes)
    equal = estimate(error=0.01, uncertainty="within_segment")
    assert equal.settings["weights"] == dict.fromkeys(CHANNELS, "one noise level for all segments")
    # P1 tells next to nothing: the other seven give almost the same as if it were left out.
    rest = estimate(error=0.01, positions={k: v for k, v in OPTIMAL.items() if k != "P1"}, uncertainty="within_segment")
    assert found["D_X_F"].standard_uncertainty == pytest.approx(rest["D_X_F"].standard_uncertainty, rel=1e-3)


def test_refusals_speak_of_what_to_do() -> None:
    with pytest.raises(EstimationError, match=r"no residual.*within_segment"):
        estimate(error=0.01, positions=dict(list(OPTIMAL.items())[:6]))
    with pytest.raises(EstimationError, match=r"do not vary.*uncertainty: residual"):
        estimate(uncertainty="within_segment")
    with pytest.raises(EstimationError, match="5 observations cannot determine 6"):
        estimate(positions=dict(list(OPTIMAL.items())[:5]))
    with pytest.raises(EstimationError, match="did you mean 'torquer_x'"):
        estimate(outputs=("torqer_x", "torquer_y"))
    with pytest.raises(EstimationError, match="two outputs"):
        estimate(outputs=("torquer_x", "torquer_x"))
    spinning = from_means(segment("S", attitude("up north west"), Spin(0.1)), dict.fromkeys(CHANNELS, 1.0), "pulse/s")
    unknown = from_means(segment("H"), dict.fromkeys(CHANNELS, 1.0), "pulse/s")
    for recorded, words in ((spinning, "'S' moves"), (unknown, "orientation of segment 'H' is unknown")):
        request = EstimateRequest("d", (recorded,), FlexureGyroStaticParameters(), SITE, sensor(*CHANNELS))
        with pytest.raises(EstimationError, match=words):
            FlexureGyroStatic().estimate(request)


def test_design_predicts_what_simulated_experiments_scatter_by() -> None:
    white = 0.3
    outputs = tuple(OutputModel(name, "pulse/s", noise=NoiseModel(white)) for name in CHANNELS)
    per_pulse = math.radians(1 / 3600)
    nominal = {"SF_X": 0.031 * per_pulse, "SF_Y": 0.029 * per_pulse, "epsilon": 0.0, "xi": 0.0}
    planned = tuple(segment(label, attitude(words)) for label, words in OPTIMAL.items())
    model = SensorModel("flexure-gyro", outputs, 10.0, nominal)
    design = designed(FlexureGyroStatic(), DesignRequest("d", planned, FlexureGyroStaticParameters(), SITE, model))
    predicted = {item.name: item for item in design.predicted}
    assert len(predicted) == 24  # the physical ones, and U0 … V5
    sigma = white / math.sqrt(120)
    matrix = np.array([_row(attitude(words)) for words in OPTIMAL.values()])
    cofactor = np.linalg.inv(matrix.T @ matrix)
    # With ε = ξ = 0 the drift D(X) is U0/U1 = SF_Y·U0, and SF_Y = 1/U1.
    assert predicted["D_X_F"].standard_uncertainty == pytest.approx(0.029 * sigma * math.sqrt(cofactor[0, 0]), rel=1e-6)
    assert predicted["SF_Y"].standard_uncertainty == pytest.approx(
        0.029**2 * sigma * math.sqrt(cofactor[1, 1]), rel=1e-6
    )
    assert design.extra["determinant"] == pytest.approx(706.081, abs=5e-4)
