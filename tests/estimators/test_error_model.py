"""The general estimator against the named ones, against outputs by independent formulas, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import simulated_imu as imu
from recorded import from_means, from_samples, noisy, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.base import plugins
from planrunner.design.identifiability import identify
from planrunner.error_model.effects.interface import Column, Variant, single
from planrunner.error_model.observed import Observed
from planrunner.estimators import method
from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.analysis import analyse, combined
from planrunner.estimators.error_model.estimator import ErrorModelEstimator
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.imu.imu_multi_position import ImuMultiPosition, ImuMultiPositionParameters
from planrunner.estimators.interface import Design, DesignRequest, Estimate, EstimateRequest, EstimationError, Setup
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.estimators.temperature.temperature_model import TemperatureModel
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.influences import Aspect, InputQuantity, Inputs

Array = np.ndarray
GYRO = ("gyro_bias", "gyro_scale_factor", "gyro_misalignment")
LINEAR = (*GYRO, "gyro_g_sensitivity")
ACCEL = ("accel_bias", "accel_scale_factor", "accel_misalignment")
AXES = dict(zip((*imu.GYROS, *imu.ACCELS), "xyzxyz", strict=True))
WHOLE: dict[str, tuple[str, ...]] = dict.fromkeys(imu.GYROS, LINEAR) | dict.fromkeys(imu.ACCELS, ACCEL)
ARCSEC, G = math.radians(1) / 3600, 9.80665
STATED = Setup(
    inputs=Inputs(
        {
            "table position": InputQuantity("table position", 0.0, "arcsec", 5 * ARCSEC, source="bench"),
            "table rate": InputQuantity("table rate", 0.0, "1", 2e-5, source="bench"),
            "azimuth": InputQuantity("azimuth", 0.0, "arcmin", 60 * ARCSEC, source="bench"),
            "latitude": InputQuantity("latitude", imu.LATITUDE, "deg", 1e-4, source="bench"),
            "gravity": InputQuantity("gravity", imu.GRAVITY, "m/s^2", 1e-4, source="bench"),
            **{
                Aspect.BIAS_INSTABILITY.of(name): InputQuantity(Aspect.BIAS_INSTABILITY.of(name), 0.0, "rad/s", 1e-7)
                for name in imu.GYROS
            },
        }
    )
)


def request_of(
    recorded: Sequence[RecordedSegment], parameters: Any, setup: Setup | None = None
) -> EstimateRequest[Any]:
    return EstimateRequest("model", tuple(recorded), parameters, imu.SITE, sensor(*AXES), setup=setup or Setup())


def estimate(
    recorded: Sequence[RecordedSegment], outputs: Mapping[str, tuple[str, ...]], setup: Setup | None = None, **keys: Any
) -> Estimate:
    keys.setdefault("axes", {name: AXES[name] for name in outputs if name in AXES})
    return ErrorModelEstimator().estimate(
        request_of(recorded, ErrorModelParameters(outputs=dict(outputs), **keys), setup)
    )


def rows(found: Estimate, kind: str) -> Array:
    """The response of each output to inputs along x, y and z, (3, 3)."""
    made = np.eye(3)
    for i, a in enumerate("xyz"):
        made[i, i] += 1e-6 * found[f"{kind}_scale_factor_{a}"].value
        for j, b in enumerate("xyz"):
            if i != j:
                made[i, j] = found[f"{kind}_misalignment_towards_{b}_{a}"].value * ARCSEC
    return made


def rows_of_named(found: Estimate, prefix: str = "") -> Array:
    """The same from scale factors along input axes and the components of these across."""
    made = np.zeros((3, 3))
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            if i != j:
                made[i, j] = 1e-3 * found[f"{prefix}misalignment_{a}_{b}"].value
        made[i, i] = math.sqrt(1 - made[i] @ made[i])
        made[i] *= found[f"{prefix}scale_{a}"].value
    return made


def carried(found: Estimate, slopes: Mapping[str, float]) -> float:
    """Standard uncertainty of a function of coefficients from its derivatives, in the coefficients' units."""
    names = [item.name for item in found.coefficients]
    places = [names.index(name) for name in slopes]
    own = np.array(list(slopes.values()))
    return math.sqrt(own @ found.covariance[np.ix_(places, places)] @ own)


def same_uncertainties(found: Estimate, named: Estimate, kind: str, prefix: str = "") -> None:
    """Of each row r: its length |r|, and its components r_b/|r| across the axis, whose derivatives are (e_b − r_b·r/|r|²)/|r|."""
    matrix = rows(found, kind)
    for i, a in enumerate("xyz"):
        row, length = matrix[i], float(np.linalg.norm(matrix[i]))
        keys = [f"{kind}_scale_factor_{a}" if a == b else f"{kind}_misalignment_towards_{b}_{a}" for b in "xyz"]
        units = np.array([1e-6 if a == b else ARCSEC for b in "xyz"])
        u = carried(found, dict(zip(keys, row / length * units, strict=True)))
        assert u == pytest.approx(named[f"{prefix}scale_{a}"].standard_uncertainty, rel=1e-9)
        for j, b in enumerate("xyz"):
            if i != j:
                slope = (np.eye(3)[j] - row[j] * row / length**2) / length * units
                u = carried(found, dict(zip(keys, 1e3 * slope, strict=True)))
                assert u == pytest.approx(named[f"{prefix}misalignment_{a}_{b}"].standard_uncertainty, rel=1e-9)


# -- the named estimators --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", ["residual", "within_segment"])
@pytest.mark.parametrize("setup", [Setup(), STATED], ids=["plain", "stated"])
def test_it_gives_what_imu_multi_position_gives(basis: str, setup: Setup) -> None:
    draw = np.random.default_rng(3)
    recorded = imu.recorded(imu.plan(), imu.drawn_truth(draw), draw, tilt=5 * ARCSEC)
    parameters = ImuMultiPositionParameters(gyros=imu.GYROS, accelerometers=imu.ACCELS, uncertainty=basis)
    named = combined(ImuMultiPosition().estimate(request_of(recorded, parameters, setup)))
    found = combined(estimate(recorded, WHOLE, setup, uncertainty=basis))
    for kind in ("gyro", "accel"):
        assert rows(found, kind) == pytest.approx(rows_of_named(named, f"{kind}_"), rel=1e-9, abs=1e-12)
        same_uncertainties(found, named, kind, f"{kind}_")
    for a in "xyz":
        for name, other, factor in (("gyro_bias", "gyro_bias", 3600.0), ("accel_bias", "accel_bias", 1.0)):
            one, same = found[f"{name}_{a}"], named[f"{other}_{a}"]
            assert one.value * factor == pytest.approx(same.value, rel=1e-9)
            assert one.standard_uncertainty * factor == pytest.approx(same.standard_uncertainty, rel=1e-9)
            assert one.degrees_of_freedom == pytest.approx(same.degrees_of_freedom, rel=1e-9)
        for b in "xyz":
            one, same = found[f"gyro_g_sensitivity_K_{b}_{a}"], named[f"gyro_g_sensitivity_K_{b}_{a}"]
            assert one.value * 3600 == pytest.approx(same.value, rel=1e-9, abs=1e-9 * same.standard_uncertainty)
            assert one.standard_uncertainty * 3600 == pytest.approx(same.standard_uncertainty, rel=1e-9)


def test_it_gives_what_accelerometer_multi_position_gives() -> None:
    draw = np.random.default_rng(4)
    recorded = imu.recorded(imu.plan(rates=()), imu.drawn_truth(draw), draw)
    named = AccelerometerMultiPosition().estimate(
        request_of(recorded, AccelerometerMultiPositionParameters(outputs=imu.ACCELS))
    )
    found = estimate(recorded, dict.fromkeys(imu.ACCELS, ACCEL))
    assert rows(found, "accel") == pytest.approx(rows_of_named(named), rel=1e-9, abs=1e-12)
    same_uncertainties(found, named, "accel")
    for a in "xyz":
        one, same = found[f"accel_bias_{a}"], named[f"bias_{a}"]
        assert one.value == pytest.approx(same.value, rel=1e-9)
        assert one.standard_uncertainty == pytest.approx(same.standard_uncertainty, rel=1e-9)


def test_it_gives_what_scale_factor_gives() -> None:
    """The line's offset is the bias and what the scale factor makes of the Earth's rate."""
    draw = np.random.default_rng(5)
    segments = [imu.spin("z", rate) for rate in (10.0, -10.0, 50.0, -50.0, 200.0, -200.0)]
    recorded = imu.recorded(segments, imu.drawn_truth(draw), draw)
    named = ScaleFactor().estimate(request_of(recorded, ScaleFactorParameters(outputs=("gz",))))
    found = estimate(recorded, {"gz": ("gyro_bias", "gyro_scale_factor")})
    scale, bias = found["gyro_scale_factor_z"], found["gyro_bias_z"]
    gain = 1 + 1e-6 * scale.value
    assert gain == pytest.approx(named["K_gz"].value, rel=1e-9)
    assert 1e-6 * scale.standard_uncertainty == pytest.approx(named["K_gz"].standard_uncertainty, rel=1e-9)
    offset = math.radians(bias.value) + gain * imu.EARTH * math.sin(imu.LATITUDE)
    assert offset == pytest.approx(named["F0_gz"].value, rel=1e-9)
    slopes = {"gyro_bias_z": math.radians(1), "gyro_scale_factor_z": 1e-6 * imu.EARTH * math.sin(imu.LATITUDE)}
    assert carried(found, slopes) == pytest.approx(named["F0_gz"].standard_uncertainty, rel=1e-9)


@pytest.mark.parametrize("thermometer", [None, "inside"])
@pytest.mark.parametrize("cycles", [1, 2])
def test_it_gives_what_temperature_model_gives(thermometer: str | None, cycles: int) -> None:
    """At the planned temperatures, and at those of a thermometer, which are up to 2 K away; rising once, and again after cooling."""
    draw = np.random.default_rng(6)
    celsius = np.array([-30.0, -10.0, 10.0, 30.0, 50.0, 70.0] * cycles)
    warm = celsius - 25
    values = 0.3 + 2e-3 * warm - 1e-5 * warm**2 + 1e-4 * draw.standard_normal(len(warm))
    away = ([1.5, -0.7, 2.0, -1.2, 0.4, -1.9] if thermometer else [0.0] * 6) * cycles
    scatter = 1e-4 * draw.standard_normal(480)
    recorded = []
    for place, (one, off, value) in enumerate(zip(celsius, away, values, strict=True)):
        start, kelvin = 100.0 * place, one - off + 273.15
        segment = replace(imu.rest("east north up", temperature=kelvin), label=f"T{place}", start=start)
        channels = {"gz": value + scatter, "inside": np.full(len(scatter), one)}
        time = start + np.arange(len(scatter)) / 8
        recorded.append(from_samples(segment, time, channels, {"gz": "deg/s", "inside": "degC"}))
    parameters = TemperatureModelParameters(channels=("gz",), order=2, temperature_channel=thermometer)
    named = TemperatureModel().estimate(request_of(recorded, parameters))
    effects = {"gz": ("gyro_bias", "gyro_bias_temperature")}
    found = estimate(recorded, effects, temperature_channel=thermometer)
    level = math.degrees(imu.EARTH * math.sin(imu.LATITUDE))
    ours = [found["gyro_bias_z"].value + level, *(found[f"gyro_bias_temperature_{c}_z"].value for c in ("c1", "c2"))]
    assert ours == pytest.approx([item.value for item in named.coefficients], rel=1e-9)
    spreads = [item.standard_uncertainty for item in found.coefficients]
    assert spreads == pytest.approx([item.standard_uncertainty for item in named.coefficients], rel=1e-9)


def test_no_drift_with_temperature_is_sought_beside_the_effect_that_the_plan_names() -> None:
    """From 40 to 90 degC, a bias that depends on the temperature alone looks almost like one that depends on its square."""
    draw, recorded = np.random.default_rng(6), []
    for place, celsius in enumerate(np.arange(40.0, 95.0, 10.0)):
        segment = replace(imu.rest("east north up", temperature=celsius + 273.15), label=f"T{place}")
        channels = {"gz": 0.3 + 1e-3 * draw.standard_normal(500), "inside": np.full(500, celsius)}
        time = 100.0 * place + np.arange(500) / 10
        recorded.append(from_samples(segment, time, channels, {"gz": "deg/s", "inside": "degC"}))
    for amplitude, asked in (("c1", False), ("c2", True)):
        effects = {"gz": ("gyro_bias", f"gyro_bias_temperature.{amplitude}")}
        found = estimate(recorded, effects, temperature_channel="inside", uncertainty="within_segment")
        assert bool([text for text in found.warnings if "hard to distinguish from" in text]) == asked


def test_it_gives_what_flexure_gyro_static_gives() -> None:
    """Each output of the flexure gyro is that of a gyro about the other axis: U1 is its scale factor, the rest are errors times U1."""
    words = (
        *("up north west", "down north east", "north up east", "north down west"),
        *("east south down", "south east up", "west south up", "south west down"),
    )
    draw = np.random.default_rng(7)
    sf, recorded = 1 / (0.2 * math.radians(1) / 3600), []
    for place, text in enumerate(words):
        rate, force = imu.felt(imu.rest(text))
        drifts = imu.DEG_H * np.array([[2.0, 1.0, -1.5, 0.5], [-1.0, 0.7, 1.1, -2.0]]) @ np.array([1, *(force / G)])
        values = sf * np.array([rate[1] + 0.003 * rate[0] + drifts[0], rate[0] - 0.002 * rate[1] + drifts[1]])
        means = dict(zip(("torquer_x", "torquer_y"), values, strict=True))
        recorded.append(noisy(imu.rest(text), means, "pulse/s", 0.01, draw, 100.0 * place))
    named = FlexureGyroStatic().estimate(request_of(recorded, FlexureGyroStaticParameters(pool_outputs=False)))
    outputs = {
        "torquer_x": ("gyro_bias", "gyro_scale_factor", "gyro_misalignment.towards_x", "gyro_g_sensitivity"),
        "torquer_y": ("gyro_bias", "gyro_scale_factor", "gyro_misalignment.towards_y", "gyro_g_sensitivity"),
    }
    found = estimate(recorded, outputs, axes={"torquer_x": "y", "torquer_y": "x"})
    for letter, own, across, cross in (("U", "y", "x", ("U1", "U2")), ("V", "x", "y", ("V2", "V1"))):
        scale = found[f"gyro_scale_factor_{own}"]
        assert scale.unit == "(pulse/s)/(deg/s)"
        assert scale.value / 3600 == pytest.approx(named[cross[0]].value, rel=1e-9)
        assert scale.standard_uncertainty / 3600 == pytest.approx(named[cross[0]].standard_uncertainty, rel=1e-9)
        towards = found[f"gyro_misalignment_towards_{across}_{own}"].value * ARCSEC
        assert towards == pytest.approx(named[cross[1]].value / named[cross[0]].value, rel=1e-9)
        errors = [found[f"gyro_bias_{own}"], *(found[f"gyro_g_sensitivity_K_{b}_{own}"] for b in "xyz")]
        for item, k in zip(errors, (0, 3, 4, 5), strict=True):
            assert item.value * scale.value == pytest.approx(named[f"{letter}{k}"].value, rel=1e-9)
            slopes = {item.name: scale.value, scale.name: item.value}
            assert carried(found, slopes) == pytest.approx(named[f"{letter}{k}"].standard_uncertainty, rel=1e-9)
        slopes = {f"gyro_misalignment_towards_{across}_{own}": scale.value * ARCSEC, scale.name: towards}
        assert carried(found, slopes) / 3600 == pytest.approx(named[cross[1]].standard_uncertainty, rel=1e-9)


# -- outputs by other formulas ---------------------------------------------------------------------------------------

OBLIQUE = tuple(
    np.roll(np.array([[math.cos(a), 0.0, math.sin(a)], [0.0, 1.0, 0.0], [-math.sin(a), 0.0, math.cos(a)]]), k, 0)
    for a in np.radians([25.0, 70.0, 110.0, 160.0, 205.0, 250.0, 290.0, 340.0])
    for k in range(3)
)


def at_all_places(degrees: Sequence[float] = (25.0,)) -> list[Segment]:
    positions = [imu.rest(text) for text in imu.POSITIONS]
    spare = [
        replace(imu.rest("east north up"), attitude=one, label=f"o{k}", orientation=f"o{k}")
        for k, one in enumerate(OBLIQUE)
    ]
    turns = [imu.spin(axis, rate) for axis in "xyz" for rate in (20.0, -20.0, 50.0, -50.0, 90.0, -90.0)]
    return [replace(one, temperature=c + 273.15) for c in degrees for one in (*positions, *spare, *turns)]


def played(
    segments: Sequence[Segment], outputs: Any, units: str, noise: float, draw: np.random.Generator | None
) -> list[RecordedSegment]:
    """outputs(rate, force, warm): (k, 3) for (k, 3) inputs about the table's way; channels are x, y, z. With `draw`, segments at rest of
    samples, whose means scatter by `noise`; else exact means."""
    found = []
    names = imu.GYROS if units == "rad/s" else imu.ACCELS
    for place, one in enumerate(segments):
        rates, forces = around(one)
        warm = (one.temperature or 298.15) - 298.15
        means = dict(zip(names, outputs(rates, forces, warm).mean(axis=0), strict=True))
        if draw is None:
            found.append(from_means(one, means, units, noise, start=200.0 * place))
        else:
            assert not one.rate
            found.append(noisy(one, means, units, noise, draw, 200.0 * place))
    return found


def around(segment: Segment) -> tuple[Array, Array]:
    """What the sensor feels on the table's way round, (k, 3) each; once at rest."""
    assert segment.attitude is not None
    earth = imu.EARTH * np.array([0, math.cos(imu.LATITUDE), math.sin(imu.LATITUDE)])
    turns = imu.TURN if segment.rate else np.eye(3)[None]
    rate = np.array([0, 0, segment.rate])
    return (turns @ earth + rate) @ segment.attitude.T, turns @ np.array([0, 0, imu.GRAVITY]) @ segment.attitude.T


def test_a_gyro_with_everything_is_found() -> None:
    """Squares and products are means over the turn, which are not those of the mean inputs. Only the mean of |ω| is not exact on an axis
    that lies across the turn, where the Earth's rate changes its sign."""
    draw = np.random.default_rng(8)
    deg = math.radians(1)
    k3, k2, asymmetry = 1e-8 / deg**2, 2e-7 / deg, 1e-4
    g2 = 1e-3 * deg / G**2 * draw.standard_normal((3, 6))
    warm_scale, c = 5e-5, 1e-3 * deg

    def outputs(rate: Array, force: Array, warm: float) -> Array:
        pairs = np.stack(
            [*(force.T**2), force[:, 0] * force[:, 1], force[:, 1] * force[:, 2], force[:, 2] * force[:, 0]], 1
        )
        made = rate * (1 + 3e-3 + warm_scale * warm) + 0.1 * deg + c * warm + pairs @ g2.T
        return np.asarray(made + k3 * rate**3 + k2 * rate**2 + asymmetry * np.abs(rate))

    effects = (
        *(
            "gyro_bias",
            "gyro_scale_factor",
            "gyro_g2_sensitivity.K_xy",
            "gyro_g2_sensitivity.K_yz",
            "gyro_g2_sensitivity.K_zx",
        ),
        *("gyro_g2_sensitivity.K_xx", "gyro_g2_sensitivity.K_yy", "gyro_scale_temperature", "gyro_bias_temperature.c1"),
        *("gyro_scale_nonlinearity", "gyro_scale_quadratic", "gyro_scale_asymmetry"),
    )
    found = estimate(
        played(at_all_places((25.0, 60.0)), outputs, "rad/s", 1e-9, None), dict.fromkeys(imu.GYROS, effects)
    )
    for i, a in enumerate("xyz"):
        assert found[f"gyro_scale_nonlinearity_{a}"].value == pytest.approx(1e-8, rel=1e-7)
        assert found[f"gyro_scale_quadratic_{a}"].value == pytest.approx(0.2, rel=1e-5)
        assert found[f"gyro_scale_asymmetry_{a}"].value == pytest.approx(100.0, rel=1e-5)
        assert found[f"gyro_scale_temperature_{a}"].value == pytest.approx(50.0, rel=1e-7)
        assert found[f"gyro_bias_temperature_c1_{a}"].value == pytest.approx(1e-3, rel=1e-7)
        assert found[f"gyro_scale_factor_{a}"].value == pytest.approx(3e3, rel=1e-7)
        for j, pair in enumerate(("xy", "yz", "zx"), start=3):
            assert found[f"gyro_g2_sensitivity_K_{pair}_{a}"].value * deg / G**2 == pytest.approx(g2[i, j], rel=1e-6)


def test_an_accelerometer_with_everything_is_found_within_its_uncertainty() -> None:
    draw = np.random.default_rng(9)
    truth = {
        "accel_second_order": 80.0,
        "accel_third_order": -30.0,
        "accel_asymmetry": 60.0,
        "accel_cross_coupling_K_xy": 40.0,
    }

    def outputs(rate: Array, force: Array, warm: float) -> Array:
        f = force / G
        made = f * 1.002 + 1e-3 + 1e-6 * (80 * f**2 - 30 * f**3 + 60 * np.abs(f) + 40 * (f[:, 0] * f[:, 1])[:, None])
        return np.asarray(G * made)

    effects = (*ACCEL, "accel_second_order", "accel_third_order", "accel_asymmetry", "accel_cross_coupling")
    at_rest = [one for one in at_all_places() if not one.rate]
    errors = []
    model = ErrorModelParameters(outputs={"az": effects}, axes={"az": "z"}, uncertainty="within_segment")
    for _ in range(40):
        made = ErrorModelEstimator().quantities(request_of(played(at_rest, outputs, "m/s^2", 1e-6 * G, draw), model))
        found = {item.name: item for item in made.coefficients}
        for name, value in truth.items():
            item = found[f"{name}_z"]
            errors.append((item.value - value) / item.standard_uncertainty)
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)  # 160 values, some of them correlated
    assert abs(np.mean(errors)) < 0.3


@dataclass(frozen=True)
class Case:
    """An effect of size one in the unit of its parameter, in the x output. added: from rates and forces (k, 3), temperature above
    25 degC [K], time [h] and change of temperature [K/min]."""

    effects: tuple[str, ...]
    name: str
    unit: str
    added: Callable[[Array, Array, float, float, float], Array | float]
    accel: bool = False


DEG, UG = math.radians(1), 1e-6 * G
CASES = [
    Case(("gyro_scale_quadratic",), "gyro_scale_quadratic_x", "ppm/(deg/s)", lambda w, f, k, h, r: 1e-6 / DEG * w[:, 0] ** 2),
    Case(
        ("gyro_bias_temperature", "gyro_bias_temperature_cubic"),
        "gyro_bias_temperature_cubic_x", "deg/s/K^3", lambda w, f, k, h, r: DEG * k**3,
    ),
    Case(
        ("gyro_misalignment_temperature",),
        "gyro_misalignment_temperature_towards_y_x", "arcsec/K", lambda w, f, k, h, r: ARCSEC * k * w[:, 1],
    ),
    Case(("gyro_bias_drift",), "gyro_bias_drift_x", "deg/h/h", lambda w, f, k, h, r: DEG / 3600 * h),
    Case(("gyro_thermal_gradient",), "gyro_thermal_gradient_x", "deg/s/(K/s)", lambda w, f, k, h, r: DEG * r / 60),
    Case(("gyro_scale_asymmetry",), "gyro_scale_asymmetry_x", "ppm", lambda w, f, k, h, r: 1e-6 * np.abs(w[:, 0])),
    Case(("accel_second_order",), "accel_second_order_x", "ug/g^2", lambda w, f, k, h, r: UG * (f[:, 0] / G) ** 2, True),
    Case(("accel_third_order",), "accel_third_order_x", "ug/g^3", lambda w, f, k, h, r: UG * (f[:, 0] / G) ** 3, True),
    Case(("accel_asymmetry",), "accel_asymmetry_x", "ppm", lambda w, f, k, h, r: 1e-6 * np.abs(f[:, 0]), True),
    Case(
        ("accel_cross_coupling",),
        "accel_cross_coupling_K_zx_x", "ug/g^2", lambda w, f, k, h, r: UG * f[:, 2] * f[:, 0] / G**2, True,
    ),
    Case(
        ("accel_misalignment_temperature",),
        "accel_misalignment_temperature_towards_z_x", "arcsec/K", lambda w, f, k, h, r: ARCSEC * k * f[:, 2], True,
    ),
    Case(("accel_thermal_gradient",), "accel_thermal_gradient_x", "ug/(K/min)", lambda w, f, k, h, r: UG * r, True),
    Case(("accel_bias_drift",), "accel_bias_drift_x", "ug/h", lambda w, f, k, h, r: UG * h, True),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_each_effect_is_found_at_its_size(case: Case) -> None:
    """Beside bias, scale factor and misalignment, at three temperatures and along a ramp, without noise."""
    segments = [
        *at_all_places((0.0, 25.0, 40.0, 60.0)),
        replace(imu.rest("east north up"), temperature=298.15, ramp_to=328.15),
    ]
    channel, unit = ("ax", "m/s^2") if case.accel else ("gx", "rad/s")
    recorded = []
    for place, one in enumerate(segments):
        rates, forces = around(one)
        start, ramp = 200.0 * place, (one.ramp_to or 0.0) - (one.temperature or 0.0) if one.ramp_to else 0.0
        minutes = (one.dwell or 0.0) / 60
        # The mean over a ramp, by many steps; 25 degC at its beginning.
        warm = (
            (one.temperature or 298.15) - 298.15 + ramp * (np.arange(2000) + 0.5) / 2000
            if ramp
            else [(one.temperature or 0) - 298.15]
        )
        middle = (start + 30 * minutes) / 3600
        extra = np.mean([np.mean(case.added(rates, forces, float(k), middle, ramp / minutes)) for k in warm])
        felt = forces if case.accel else rates
        value = float(felt[:, 0].mean()) * 1.001 + 1e-3 + float(extra)
        recorded.append(from_means(one, {channel: value}, unit, 1e-9, start=start))
    base = ACCEL if case.accel else GYRO
    found = estimate(recorded, {channel: (*base, *case.effects)})
    item = found[case.name]
    assert item.unit == case.unit
    assert item.value == pytest.approx(1.0, rel=1e-4)


# -- planning --------------------------------------------------------------------------------------------------------


def designed(segments: Sequence[Segment], outputs: Mapping[str, tuple[str, ...]], **keys: Any) -> Design:
    noisy = NoiseModel(white=1e-5)
    models = [OutputModel(name, "rad/s" if name in imu.GYROS else "m/s^2", noise=noisy) for name in AXES]
    keys.setdefault("axes", {name: axis for name, axis in AXES.items() if name in outputs})
    parameters = ErrorModelParameters(outputs=dict(outputs), **keys)
    request = DesignRequest("model", tuple(segments), parameters, imu.SITE, SensorModel("imu", tuple(models), 100.0))
    return method.designed(ErrorModelEstimator(), request)


def test_uncertainties_are_predicted() -> None:
    """Predicted from the declared noise; found from five recordings, of which the pooled u scatters by 1.3 %."""
    draw = np.random.default_rng(10)
    segments = imu.plan()
    expected = designed(segments, WHOLE, uncertainty="within_segment")
    assert all(judged.sound for judged in identify(expected))
    truth = imu.drawn_truth(draw)
    found = [
        estimate(imu.recorded(segments, truth, draw, (1e-5, 1e-5)), WHOLE, uncertainty="within_segment").coefficients
        for _ in range(5)
    ]
    predicted = {item.name: item for item in expected.predicted}
    assert [item.name for item in found[0]] == list(predicted)
    for each in zip(*found, strict=True):
        one = predicted[each[0].name]
        assert each[0].unit == one.unit
        pooled = math.sqrt(np.mean([item.standard_uncertainty**2 for item in each]))
        assert pooled == pytest.approx(one.standard_uncertainty, rel=0.05), one.name


def test_an_effect_of_another_package_that_gives_no_axis_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it, nobody would know whether the outputs have its amplitude in common."""

    class Forgetful:
        id, stage, shown_by = "gyro_bias", "sensor", "positions"

        def variants(self, observed: Observed) -> list[Variant]:
            parts = {index: np.ones(len(observed.time)) for index in observed.of_kind("gyro")}
            return single([Column("b", "deg/h", 4.8e-6, 4.8e-6, parts)])  # type: ignore[call-arg]

    shipped = plugins.load
    monkeypatch.setattr(plugins, "load", lambda group, name: Forgetful if name == "gyro_bias" else shipped(group, name))
    parameters = ErrorModelParameters(outputs={"gx": ("gyro_bias",)}, axes={"gx": "x"})
    estimates = {"model": EstimateSpec(estimator="error_model", segments=("*",), uses=(), parameters=parameters)}
    recorded = imu.recorded(imu.plan(), imu.drawn_truth(np.random.default_rng(1)))
    found = analyse(estimates, [], recorded, imu.SITE, sensor(*AXES))
    assert "argument: 'axis'" in found.failures["model"] and "author" in found.failures["model"]


def test_what_the_segments_do_not_show_is_named_with_what_would_show_it() -> None:
    design = designed([imu.rest(text) for text in imu.POSITIONS], {"gx": (*LINEAR, "gyro_scale_temperature")})
    (remark,) = design.remarks
    assert remark.error and remark.code == "physics-rank" and remark.key == "outputs.gx"
    assert "gyro_scale_temperature_x is zero" in remark.message and "two temperatures" in remark.hint


@pytest.mark.parametrize(
    ("outputs", "message", "hint"),
    [
        ({"gx": ("accel_bias",)}, "'accel_bias' does not act on gx, a gyro", "leave it out"),
        ({"gx": ("gyro_bandwidth",)}, "does not act on gx, a gyro, in these segments", "rocking segments"),
        ({"gx": ("gyro_bias_random_walk",)}, "noise", "leave it out"),
        ({"gx": ("gyro_noise_excess",)}, "noise", "leave it out"),
        ({"gx": ("table_position_error",)}, "position_uncertainty", "leave it out"),
        ({"gx": ("gyro_g_sensitivity.K_q",)}, "no parameter 'K_q'", "did you mean"),
        ({"gx": ("magnetic_sensitivity",)}, "does not act on gx", "magnetic_field"),
        ({"other": ("gyro_bias",)}, "no output 'other'", "known here: ax"),
    ],
)
def test_what_cannot_be_estimated_is_refused(outputs: Mapping[str, tuple[str, ...]], message: str, hint: str) -> None:
    with pytest.raises(EstimationError, match=message) as refused:
        designed(imu.plan(), outputs, axes=dict.fromkeys(outputs, "x"))
    assert hint in refused.value.hint
    assert refused.value.key.startswith("outputs.")
