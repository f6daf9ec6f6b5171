"""Declares the bench-file keys that sensors on serial lines have in common: port, rate, and declared noise and full scale."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.parameters import QuantityLike, nominal_supply
from planrunner.plan.kinds import Number, QuantityOf, Record, RecordOf, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.units import unit

KIND = r"[a-z][a-z0-9-]{0,39}"
PORT = r"[^\x00-\x1f]{1,200}"
FASTEST_BAUD = 20_000_000
RATES, ACCELERATIONS = ("deg/s", "rad/s"), ("g", "m/s^2")


class GyroKnowledge(Record):
    """Declares the bench-file keys for declared properties of the gyros, which are the same for all axes."""

    full_scale: Quantity | None = optional(
        QuantityOf("angular rate", "positive"),
        "Largest rate, for both signs; `check` compares plans with it.",
        "400 deg/s",
    )
    angle_random_walk: Quantity | None = optional(
        QuantityLike("deg/sqrt(h)", "not negative"),
        "White noise N: a mean over T scatters by N/√T. `check` and `design` predict uncertainties from it.",
        "0.15 deg/sqrt(h)",
    )
    bias_instability: Quantity | None = optional(
        QuantityOf("angular rate", "not negative"),
        "Coefficient B of IEEE Std 952; the flat part of the Allan deviation is 0.664·B.",
        "0.3 deg/h",
    )


class AccelerometerKnowledge(Record):
    """Declares the bench-file keys for declared properties of the accelerometers, which are the same for all axes."""

    full_scale: Quantity | None = optional(
        QuantityOf("acceleration", "positive"), "Largest specific force, for both signs.", "10 g"
    )
    velocity_random_walk: Quantity | None = optional(
        QuantityLike("m/s/sqrt(h)", "not negative"),
        "White noise N: a mean over T scatters by N/√T.",
        "0.07 m/s/sqrt(h)",
    )
    bias_instability: Quantity | None = optional(
        QuantityOf("acceleration", "not negative"),
        "Coefficient B of IEEE Std 952; the flat part of the Allan deviation is 0.664·B.",
        "0.05 mg",
    )


class SerialSensorParameters(Record):
    """Declares the bench-file keys that every sensor on a serial line has."""

    port: str = key(
        Text(PORT, "a port's name"),
        "Serial port, or a URL that pyserial knows, such as socket://127.0.0.1:4001.",
        "/dev/ttyUSB0",
    )
    baud: int = key(
        Number(1200, FASTEST_BAUD, integer=True), "Bit rate of the line, in bits per second.", 921600, default=921600
    )
    kind: str = key(Text(KIND, "a sensor kind"), "Kind of sensor, as plans name it.", "imu", default="imu")
    sample_rate: Quantity = key(
        QuantityOf("frequency", "positive"),
        "Frames per second that the sensor is set to send; compared with the received rate.",
        "1000 Hz",
    )
    silence: Quantity = key(
        QuantityOf("time", "positive"),
        "Longest time without a good frame; the run ends after this time.",
        "1 s",
        default=parse_quantity("1 s"),
    )
    thermal_lag: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Time constant with which the sensor's temperature follows the chamber's air; `check` compares soaks with it.",
        "10 min",
    )
    nominal_supply: Quantity = nominal_supply()
    gyros: GyroKnowledge | None = optional(
        RecordOf(GyroKnowledge), "Declared properties of the gyros.", {"angle_random_walk": "0.15 deg/sqrt(h)"}
    )
    accelerometers: AccelerometerKnowledge | None = optional(
        RecordOf(AccelerometerKnowledge), "Declared properties of the accelerometers.", {"full_scale": "10 g"}
    )


def sensor_model(
    parameters: SerialSensorParameters,
    channels: Mapping[str, str],
    resolutions: Mapping[str, float],
    inclinometers: Collection[str] = (),
) -> SensorModel:
    """Makes the model of a sensor.

    `channels`: maps the name of each channel to its unit. `resolutions`: size of one count of each channel, in the unit of the
    channel. `inclinometers`: channels in units of acceleration that are not accelerometers.
    """
    outputs = tuple(
        _output(name, text, resolutions.get(name, 0.0), parameters, name not in inclinometers)
        for name, text in channels.items()
    )
    nominal = {f"K_{name}": 1.0 for name, text in channels.items() if text in (*RATES, *ACCELERATIONS)}
    lag = 0.0 if parameters.thermal_lag is None else parameters.thermal_lag.value
    return SensorModel(
        parameters.kind,
        outputs,
        parameters.sample_rate.value,
        nominal,
        one_rate=True,
        thermal_lag=lag,
        nominal_supply=parameters.nominal_supply.value,
    )


def _output(name: str, text: str, resolution: float, parameters: SerialSensorParameters, inertial: bool) -> OutputModel:
    """Makes the model of an output. `inertial`: False for the output of an inclinometer, to which the declared properties of the
    accelerometers do not apply. `text`: unit of the output. `resolution`: size of one count, in this unit."""
    known: GyroKnowledge | AccelerometerKnowledge | None = None
    walk: Quantity | None = None
    if text in RATES and parameters.gyros is not None:
        known, walk = parameters.gyros, parameters.gyros.angle_random_walk
    elif text in ACCELERATIONS and inertial and parameters.accelerometers is not None:
        known, walk = parameters.accelerometers, parameters.accelerometers.velocity_random_walk
    if known is None:
        return OutputModel(name, text, noise=NoiseModel(resolution=resolution))
    factor = unit(text).factor

    def amount(quantity: Quantity | None, otherwise: float) -> float:
        return otherwise if quantity is None else quantity.value / factor

    flicker = known.bias_instability
    noise = NoiseModel(amount(walk, 0.0), amount(flicker, 0.0), resolution, states_flicker=flicker is not None)
    return OutputModel(name, text, amount(known.full_scale, math.inf), noise)
