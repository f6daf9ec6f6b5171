"""Describes one input axis of a virtual inertial sensor by numbers: its direction and its errors.

Let u be the mean inertial rate (for an accelerometer, the mean specific force) along the axis over a sampling interval. Let ΔT, ΔV
and Δp be the differences from the reference temperature, the nominal supply voltage and the standard atmosphere, and f the mean
specific force along the sensor's axes. The output is then

    y = K·(1 + δ + Σ κ_k·ΔT^k + κ_V·ΔV + κ_p·Δp)
          · (u + a·|u|/2 + q₂·u² + q₃·u³ + s·f + b + Σ β_k·ΔT^k + β_V·ΔV + β_p·Δp + A·e^(−t/τ) + slow noise) + white noise.

The output y is then limited to the output range and counted, or limited and rounded. `docs/virtual-sensors.md` names every
coefficient. In this module, all coefficients are in SI units with radians.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.models import NoiseModel, OutputModel, Senses
from planrunner.instruments.virtual.courses import Value
from planrunner.instruments.virtual.imu_keys import (
    FRAME,
    Accelerometers,
    Gyros,
    InputAxisDirection,
    VirtualImuParameters,
)
from planrunner.instruments.virtual.world import Components
from planrunner.plan.units import unit

WARM_UP_TIME = 600.0  # s, the default


@dataclass(frozen=True, slots=True)
class InertialAxis:
    """Contains one input axis and its coefficients, with the symbols that the docstring of the module uses.

    `name`, `unit`: name and unit of the output. `direction`: array of shape (3,), unit vector along the axis in the sensor's frame.
    `nominal`: declared scale factor K, in the output's unit per SI input. `error`: relative scale-factor error δ. `step`: smallest
    step of a sample in `unit`, or size of a count in unit·s if `counted` is True. `white`: coefficient N of the white noise, SI·√s.
    `walk`: coefficient of the random walk of the bias, SI/√s. `warm_up`: amplitude A of the warm-up in SI units. `warm_up_time`:
    time constant τ of the warm-up, s.
    """

    name: str
    unit: str
    turns: bool
    direction: tuple[float, float, float]
    scale_factor: float
    nominal: float
    error: float
    error_temperature: tuple[float, ...]
    error_supply: float
    error_pressure: float
    error_repeatability: float
    asymmetry: float
    quadratic: float
    cubic: float
    sensitivity: tuple[float, float, float]
    bias: float
    bias_temperature: tuple[float, ...]
    bias_supply: float
    bias_pressure: float
    bias_repeatability: float
    warm_up: float
    warm_up_time: float
    dead_zone: float
    step: float
    counted: bool
    full_scale: float
    white: float
    bias_instability: float
    states_flicker: bool
    walk: float

    def output(self, rate: float) -> OutputModel:
        """Returns the declared model of the output, sampled at `rate` [Hz]."""
        noise = NoiseModel(
            self.white * self.nominal,
            self.bias_instability * self.nominal,
            self.step_of_sample(rate),
            self.counted,
            self.states_flicker,
        )
        senses: Senses = "angular rate" if self.turns else "acceleration"
        return OutputModel(self.name, self.unit, self.full_scale * self.nominal, noise, senses=senses)

    def step_of_sample(self, rate: float) -> float:
        """Returns the smallest step of one sample, in `unit`. `rate`: sample rate, Hz."""
        return self.step * rate if self.counted else self.step

    def scale(self, off: Array, drawn: float) -> Array:
        """Returns the true scale factor in the output's unit per SI input. `off`: difference [K] from the reference temperature.
        `drawn`: relative error that was drawn at switch-on."""
        return self.nominal * (1 + self.error + drawn + _polynomial(self.error_temperature, off))

    def drift(self, off: Array, since: Array, drawn: float) -> Array:
        """Returns the bias in SI units.

        `off`: difference [K] from the reference temperature. `since`: time [s] after switch-on. `drawn`: bias that was drawn at
        switch-on.
        """
        steady = self.bias + drawn + _polynomial(self.bias_temperature, off)
        return steady + self.warm_up * np.exp(-since / self.warm_up_time) if self.warm_up else steady

    def by_surroundings(self, volts: float, pascals: float) -> tuple[float, float]:
        """Returns the changes of the bias (SI) and of the scale factor (relative) due to supply voltage and pressure. `volts`:
        supply voltage above its nominal value, V. `pascals`: pressure above the standard atmosphere, Pa."""
        return (
            self.bias_supply * volts + self.bias_pressure * pascals,
            self.error_supply * volts + self.error_pressure * pascals,
        )

    def felt(self, rates: Components, forces: Components) -> Value:
        """Returns the input (SI), including the errors that do not depend on temperature or time; a float if nothing moves."""
        u = _along(self.direction, rates if self.turns else forces)
        felt = u
        if self.asymmetry:
            felt = felt + 0.5 * self.asymmetry * np.abs(u)
        if self.quadratic or self.cubic:
            felt = felt + (self.quadratic + self.cubic * u) * u * u
        if any(self.sensitivity):
            felt = felt + _along(self.sensitivity, forces)
        return felt

    def level(self, felt: Value, drift: Array, scale: Array, hold: int) -> Array:
        """Returns the output without white noise, in `unit`. `drift`, `scale`: one value for every `hold` samples. The result has
        the length of `felt`, or of `drift` if `felt` is a float."""
        if isinstance(felt, np.ndarray):
            drift, scale = (np.repeat(values, hold)[: felt.size] for values in (drift, scale))
        total = felt + drift
        if self.dead_zone:
            total[np.abs(total) < self.dead_zone] = 0.0
        level: Array = scale * total
        return level


def axes_of(parameters: VirtualImuParameters) -> tuple[InertialAxis, ...]:
    """Returns the gyros, then the accelerometers, in the order of the bench file."""
    groups = (("gyro", parameters.gyros), ("accel", parameters.accelerometers))
    return tuple(
        _axis(f"{prefix}_{name}", name, group, axis)
        for prefix, group in groups
        if group is not None
        for name, axis in group.axes.items()
    )


def _axis(output: str, name: str, group: Gyros | Accelerometers, axis: Any) -> InertialAxis:
    turns = isinstance(group, Gyros)

    def stated(key: str) -> Any:
        own = getattr(axis, key)
        return own if own is not None else getattr(group, key)

    def number(key: str, otherwise: float = 0.0) -> float:
        quantity = stated(key)
        return otherwise if quantity is None else float(quantity.value)

    def numbers(key: str) -> tuple[float, ...]:
        return tuple(quantity.value for quantity in stated(key) or ())

    def sensitivity(along: str) -> float:
        quantity = (stated("g_sensitivity") or {}).get(along) if turns else None
        return quantity.value if quantity is not None else 0.0

    scale, resolution = stated("scale_factor"), stated("resolution")
    in_pulses = scale is not None and scale.unit.dimension != ()
    unit_ = "pulse/s" if in_pulses else "deg/s" if turns else "m/s^2"
    nominal = number("scale_factor", 1.0) / unit(unit_).factor
    counted = resolution is not None and resolution.unit.dimension == unit("rad" if turns else "m/s").dimension
    return InertialAxis(
        name=output,
        unit=unit_,
        turns=turns,
        direction=_direction(name, axis),
        scale_factor=number("scale_factor", 1.0),
        nominal=nominal,
        error=number("scale_factor_error"),
        error_temperature=numbers("scale_factor_temperature"),
        error_supply=number("scale_factor_supply"),
        error_pressure=number("scale_factor_pressure"),
        error_repeatability=number("scale_factor_repeatability"),
        asymmetry=number("scale_factor_asymmetry"),
        quadratic=number("quadratic"),
        cubic=number("cubic"),
        sensitivity=(sensitivity("x"), sensitivity("y"), sensitivity("z")),
        bias=number("bias"),
        bias_temperature=numbers("bias_temperature"),
        bias_supply=number("bias_supply"),
        bias_pressure=number("bias_pressure"),
        bias_repeatability=number("bias_repeatability"),
        warm_up=number("warm_up"),
        warm_up_time=number("warm_up_time", WARM_UP_TIME),
        dead_zone=number("dead_zone"),
        step=number("resolution") * nominal,
        counted=counted,
        full_scale=number("full_scale", math.inf),
        white=number("angle_random_walk" if turns else "velocity_random_walk"),
        bias_instability=number("bias_instability"),
        states_flicker=stated("bias_instability") is not None,
        walk=number("rate_random_walk" if turns else "acceleration_random_walk"),
    )


def _direction(name: str, axis: InputAxisDirection) -> tuple[float, float, float]:
    """Returns the unit vector of an input axis in the sensor's frame."""
    if axis.angle is not None and axis.azimuth is not None:
        tilt, azimuth = axis.angle.value, axis.azimuth.value
        return (math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt))
    lean = {along: math.tan(angle.value) for along, angle in (axis.towards or {}).items()}
    lean[axis.axis or name] = 1.0
    x, y, z = (lean.get(along, 0.0) for along in FRAME)
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length)


def _along(direction: tuple[float, float, float], vector: Components) -> Value:
    return direction[0] * vector[0] + direction[1] * vector[1] + direction[2] * vector[2]


def _polynomial(coefficients: tuple[float, ...], off: Array) -> Array:
    """Returns the polynomial Σ c_k·off^k, where k starts at 1."""
    total = np.zeros_like(off)
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * off
    return total
