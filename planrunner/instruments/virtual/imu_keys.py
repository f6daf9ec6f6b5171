"""Declares the bench-file keys of a virtual inertial sensor: its axes and their errors.

A key at the level of `axes` applies to all gyros (or accelerometers); the same key of an axis takes precedence. A value that is not
given is zero. `docs/virtual-sensors.md` describes the error model with these coefficients.
"""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.instruments.parameters import Polynomial, QuantityLike, nominal_supply
from planrunner.plan.kinds import Boolean, Choice, MapOf, QuantityOf, Record, RecordOf, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity

MOST_AXES = 12
AXIS_NAME = r"[A-Za-z0-9][A-Za-z0-9_]{0,15}"
KIND = r"[a-z][a-z0-9-]{0,39}"
FRAME = ("x", "y", "z")


class ScaleErrors(Record):
    """Declares the bench-file keys for the differences between the true and the declared scale factor; gyros and accelerometers
    have the same keys."""

    scale_factor_error: Quantity | None = optional(
        QuantityOf("ratio"),
        "Relative error of the declared scale factor: (true − declared)/declared, at the reference temperature.",
        "150 ppm",
    )
    scale_factor_asymmetry: Quantity | None = optional(
        QuantityOf("ratio"), "2·(K₊ − K₋)/(K₊ + K₋) of the scale factors for positive and negative input.", "20 ppm"
    )
    scale_factor_temperature: tuple[Quantity, ...] | None = optional(
        Polynomial("ppm"), "Relative change of the scale factor: coefficients of ΔT, ΔT², ΔT³.", ["30 ppm/K"]
    )
    scale_factor_supply: Quantity | None = optional(
        QuantityLike("ppm/V"),
        "Relative change of the scale factor per volt of supply above `nominal_supply`.",
        "50 ppm/V",
    )
    scale_factor_pressure: Quantity | None = optional(
        QuantityLike("ppm/hPa"),
        "Relative change of the scale factor per hPa of ambient pressure above 1013.25 hPa.",
        "0.2 ppm/hPa",
    )
    scale_factor_repeatability: Quantity | None = optional(
        QuantityOf("ratio", "not negative"),
        "Standard deviation of the scale factor from one switch-on to the next.",
        "10 ppm",
    )
    warm_up_time: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Time constant with which the warm-up error decays; by default 10 min.",
        "10 min",
    )


class GyroErrors(ScaleErrors):
    """Declares the bench-file keys for the errors of one gyro, or of all gyros."""

    scale_factor: Quantity | None = optional(
        QuantityLike("(pulse/s)/(deg/s)", "positive", ("1",)),
        "Declared scale factor: with a ratio the output is in deg/s, with pulses per angle in pulse/s. By default 1.",
        "1000 (pulse/s)/(deg/s)",
    )
    bias: Quantity | None = optional(QuantityOf("angular rate"), "Bias at the reference temperature.", "0.05 deg/h")
    bias_temperature: tuple[Quantity, ...] | None = optional(
        Polynomial("deg/h"), "Change of the bias: coefficients of ΔT, ΔT², ΔT³.", ["0.002 deg/h/K", "1e-5 deg/h/K^2"]
    )
    bias_supply: Quantity | None = optional(
        QuantityLike("deg/h/V"), "Change of the bias per volt of supply above `nominal_supply`.", "0.5 deg/h/V"
    )
    bias_pressure: Quantity | None = optional(
        QuantityLike("deg/h/hPa"),
        "Change of the bias per hPa of ambient pressure above 1013.25 hPa.",
        "0.001 deg/h/hPa",
    )
    bias_repeatability: Quantity | None = optional(
        QuantityOf("angular rate", "not negative"),
        "Standard deviation of the bias from one switch-on to the next.",
        "0.02 deg/h",
    )
    warm_up: Quantity | None = optional(
        QuantityOf("angular rate"), "Additional bias at switch-on, which decays exponentially.", "0.3 deg/h"
    )
    quadratic: Quantity | None = optional(
        QuantityLike("ppm/(deg/s)"), "Nonlinearity: coefficient of the squared input.", "0.02 ppm/(deg/s)"
    )
    cubic: Quantity | None = optional(
        QuantityLike("ppm/dps^2"), "Nonlinearity: coefficient of the cubed input.", "1e-4 ppm/dps^2"
    )
    g_sensitivity: dict[str, Quantity] | None = optional(
        MapOf(QuantityLike("deg/h/g"), names=FRAME),
        "Bias proportional to the specific force along the sensor's axes.",
        {"x": "0.1 deg/h/g", "z": "-0.2 deg/h/g"},
    )
    dead_zone: Quantity | None = optional(
        QuantityOf("angular rate", "not negative"), "Threshold: a smaller input gives no output.", "0.002 deg/h"
    )
    resolution: Quantity | None = optional(
        QuantityLike("arcsec", "not negative", ("deg/s",)),
        "Smallest step. An output in pulses counts angle steps and carries the remainder to the next sample; a rate is rounded sample by "
        "sample.",
        "0.01 arcsec",
    )
    full_scale: Quantity | None = optional(
        QuantityOf("angular rate", "positive"), "Largest input, for both signs; unlimited by default.", "400 deg/s"
    )
    angle_random_walk: Quantity | None = optional(
        QuantityLike("deg/sqrt(h)", "not negative"),
        "White noise N: a mean over T scatters by N/√T.",
        "0.003 deg/sqrt(h)",
    )
    bias_instability: Quantity | None = optional(
        QuantityOf("angular rate", "not negative"),
        "Coefficient B of IEEE Std 952; the flat part of the Allan deviation is 0.664·B.",
        "0.005 deg/h",
    )
    rate_random_walk: Quantity | None = optional(
        QuantityLike("deg/h/sqrt(h)", "not negative"),
        "Random walk of the bias: it scatters by K·√T.",
        "0.001 deg/h/sqrt(h)",
    )


class AccelerometerErrors(ScaleErrors):
    """Declares the bench-file keys for the errors of one accelerometer, or of all accelerometers."""

    scale_factor: Quantity | None = optional(
        QuantityLike("(pulse/s)/(m/s^2)", "positive", ("1",)),
        "Declared scale factor: with a ratio the output is in m/s^2, with pulses per velocity in pulse/s. By default 1.",
        "10000 (pulse/s)/(m/s^2)",
    )
    bias: Quantity | None = optional(QuantityOf("acceleration"), "Bias at the reference temperature.", "50 ug")
    bias_temperature: tuple[Quantity, ...] | None = optional(
        Polynomial("ug"), "Change of the bias: coefficients of ΔT, ΔT², ΔT³.", ["5 ug/K"]
    )
    bias_supply: Quantity | None = optional(
        QuantityLike("ug/V"), "Change of the bias per volt of supply above `nominal_supply`.", "20 ug/V"
    )
    bias_pressure: Quantity | None = optional(
        QuantityLike("ug/hPa"), "Change of the bias per hPa of ambient pressure above 1013.25 hPa.", "0.1 ug/hPa"
    )
    bias_repeatability: Quantity | None = optional(
        QuantityOf("acceleration", "not negative"),
        "Standard deviation of the bias from one switch-on to the next.",
        "20 ug",
    )
    warm_up: Quantity | None = optional(
        QuantityOf("acceleration"), "Additional bias at switch-on, which decays exponentially.", "100 ug"
    )
    quadratic: Quantity | None = optional(
        QuantityLike("ug/g^2"), "Nonlinearity: coefficient of the squared input.", "10 ug/g^2"
    )
    cubic: Quantity | None = optional(
        QuantityLike("ug/g^3"), "Nonlinearity: coefficient of the cubed input.", "1 ug/g^3"
    )
    dead_zone: Quantity | None = optional(
        QuantityOf("acceleration", "not negative"), "Threshold: a smaller input gives no output.", "1 ug"
    )
    resolution: Quantity | None = optional(
        QuantityLike("m/s", "not negative", ("m/s^2",)),
        "Smallest step. An output in pulses counts velocity steps and carries the remainder to the next sample; an "
        "acceleration is rounded sample by sample.",
        "1e-5 m/s",
    )
    full_scale: Quantity | None = optional(
        QuantityOf("acceleration", "positive"), "Largest input, for both signs; unlimited by default.", "20 g"
    )
    velocity_random_walk: Quantity | None = optional(
        QuantityLike("m/s/sqrt(h)", "not negative"),
        "White noise N: a mean over T scatters by N/√T.",
        "0.02 m/s/sqrt(h)",
    )
    bias_instability: Quantity | None = optional(
        QuantityOf("acceleration", "not negative"),
        "Coefficient B of IEEE Std 952; the flat part of the Allan deviation is 0.664·B.",
        "10 ug",
    )
    acceleration_random_walk: Quantity | None = optional(
        QuantityLike("ug/sqrt(h)", "not negative"), "Random walk of the bias: it scatters by K·√T.", "1 ug/sqrt(h)"
    )


class InputAxisDirection(Record):
    """Declares the bench-file keys for the direction of an input axis in the sensor's frame. The axis is tilted by a fixture, or is
    close to an axis of the frame."""

    angle: Quantity | None = optional(
        QuantityOf("angle"), "True angle from the frame's z axis; with `azimuth`.", "54.7391 deg"
    )
    azimuth: Quantity | None = optional(
        QuantityOf("angle"), "True azimuth about the frame's z axis, right-handed from x.", "120 deg"
    )
    axis: str | None = optional(
        Choice(FRAME),
        "Axis of the frame along which the input axis nominally points; by default the axis with the same name.",
        "x",
    )
    towards: dict[str, Quantity] | None = optional(
        MapOf(QuantityOf("angle"), names=FRAME),
        "Misalignments: small angles by which the axis is tilted towards the other two axes of the frame.",
        {"y": "12 arcsec", "z": "-5 arcsec"},
    )


class GyroAxis(GyroErrors, InputAxisDirection):
    """Declares the bench-file keys of one gyro."""


class AccelerometerAxis(AccelerometerErrors, InputAxisDirection):
    """Declares the bench-file keys of one accelerometer."""


class Gyros(GyroErrors):
    """Declares the bench-file keys of the gyros: the axes, and errors that all gyros have in common."""

    axes: dict[str, GyroAxis] = key(
        MapOf(RecordOf(GyroAxis), pattern=AXIS_NAME),
        "The gyros by name, 1 to 12; the output of `x` is `gyro_x`.",
        {"x": {"bias": "0.05 deg/h"}, "y": {}, "z": {}},
    )


class Accelerometers(AccelerometerErrors):
    """Declares the bench-file keys of the accelerometers: the axes, and errors that all accelerometers have in common."""

    axes: dict[str, AccelerometerAxis] = key(
        MapOf(RecordOf(AccelerometerAxis), pattern=AXIS_NAME),
        "The accelerometers by name, 1 to 12; the output of `x` is `accel_x`.",
        {"x": {"bias": "50 ug"}, "y": {}, "z": {}},
    )


def check_axes(group: Gyros | Accelerometers, log: Findings) -> None:
    """Adds findings about the directions and the number of the input axes."""
    if not 1 <= len(group.axes) <= MOST_AXES:
        log.error("form-size", group.at("axes"), f"{len(group.axes)} axes are given here", f"give 1 to {MOST_AXES}")
    for name, axis in group.axes.items():
        problem = _problem(name, axis)
        if problem is not None:
            log.error("meaning-input-axis", axis.origin.mark, f"the axis '{name}' {problem[0]}", problem[1])


def _problem(name: str, axis: InputAxisDirection) -> tuple[str, str] | None:
    """Returns the fault in the direction of an axis, and a hint that states how to correct the direction; None if there is no
    fault."""
    if (axis.angle is None) != (axis.azimuth is None):
        given, missing = ("azimuth", "angle") if axis.angle is None else ("angle", "azimuth")
        return f"has an {given} but no {missing}", f"add for example `{missing}: 0 deg`"
    if axis.angle is not None:
        if axis.axis is not None or axis.towards is not None:
            return "is placed twice: by angle and azimuth, and by axis", "keep one of them"
        return None
    nominal = axis.axis or name
    if nominal not in FRAME:
        hint = "add for example `axis: x`, or `angle: 54.7356 deg, azimuth: 0 deg`"
        return "has no direction", hint
    lean = axis.towards or {}
    if nominal in lean:
        return f"lies along {nominal}, so it cannot be tilted towards {nominal}", "name the other two axes of the frame"
    large = [towards for towards, angle in lean.items() if abs(angle.value) > 0.2]
    if large:
        return (
            f"is tilted by {lean[large[0]]} towards {large[0]}, which is not a small angle",
            "use `angle` and `azimuth`",
        )
    return None


class VirtualImuParameters(Record):
    """Declares the bench-file keys of a simulated inertial sensor whose true errors are known. The sensor has gyros, accelerometers
    or both, and a thermometer."""

    kind: str = key(
        Text(KIND, "a kind of sensor", "lower-case letters, digits and -, such as gyro-triad"),
        "Kind of sensor, as plans name it.",
        "gyro-triad",
        default="imu",
    )
    gyros: Gyros | None = optional(
        RecordOf(Gyros, check_axes), "The gyros.", {"angle_random_walk": "0.003 deg/sqrt(h)", "axes": {"x": {}}}
    )
    accelerometers: Accelerometers | None = optional(
        RecordOf(Accelerometers, check_axes), "The accelerometers.", {"axes": {"x": {"bias": "50 ug"}}}
    )
    sample_rate: Quantity = key(QuantityOf("frequency", "positive"), "Samples per second.", "200 Hz")
    reference_temperature: Quantity = key(
        QuantityOf("temperature"), "T₀ of the temperature polynomials.", "25 degC", default=parse_quantity("25 degC")
    )
    thermal_lag: Quantity = key(
        QuantityOf("time", "positive"),
        "Time constant with which the sensor's temperature follows the air.",
        "15 min",
        default=parse_quantity("10 min"),
    )
    thermometer_noise: Quantity = key(
        QuantityOf("temperature", "not negative"),
        "Noise of one temperature reading.",
        "0.005 K",
        default=parse_quantity("0.005 K"),
    )
    nominal_supply: Quantity = nominal_supply()
    voltmeter_noise: Quantity | None = optional(
        QuantityOf("voltage", "not negative"),
        "Noise of one reading of the supply voltage. With this key, the sensor records the channel `supply_voltage`.",
        "1 mV",
    )
    barometer_noise: Quantity | None = optional(
        QuantityOf("pressure", "not negative"),
        "Noise of one reading of the ambient pressure. With this key, the sensor records the channel `ambient_pressure`.",
        "5 Pa",
    )
    reference: bool = key(
        Boolean(), "True to record true position and velocity in addition to the outputs.", True, default=False
    )
    table_angle: bool = key(
        Boolean(),
        "True to record, in addition to the outputs, the angle by which the table has turned since it "
        "reached the orientation, as a mean over the sampling interval.",
        True,
        default=False,
    )
