"""The virtual flexure gyro (dynamically tuned, two input axes X and Y, spin axis Z) with torque-rebalance loops.

The loops drive currents through the torquers. The currents turn (precess) the rotor at the input rate. The currents, counted in
pulses, therefore measure the input. The outputs are the currents i_x and i_y. Torquer Y turns the rotor at the rate SF_Y·i_x in the
direction (cos ε, sin ε). Torquer X turns the rotor at the rate SF_X·i_y in the direction (−sin(ε+ξ), cos(ε+ξ)). The first component
of a direction is along ω_Y, the second along ω_X. The sum of these two rates must balance (ω_Y + D(X), ω_X + D(Y)). The drifts D(X)
and D(Y) each have a constant part and parts proportional to the specific force along X, Y and Z (patent CN100554884C). The
simulation solves this balance. The simulation has no formula in common with the estimators.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.documents import Json
from planrunner.instruments.interfaces import Block, InstrumentError, OnlyRead, Surroundings
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.parameters import QuantityLike
from planrunner.instruments.virtual.courses import Value
from planrunner.instruments.virtual.noise import Flicker, Readout, generator
from planrunner.instruments.virtual.streaming import Sampling
from planrunner.plan.kinds import QuantityOf, Record, RecordOf, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.schedule import Segment
from planrunner.plan.units import ZERO_CELSIUS

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import Components, World

OUTPUTS = ("torquer_x", "torquer_y")
THERMOMETER = "sensor_temperature"


class ScaleFactors(Record):
    """Declares the bench-file keys for the scale factor of each torquer, which is the rate that corresponds to one pulse per
    second."""

    x: Quantity = key(
        QuantityLike("(deg/h)/(pulse/s)", "positive"), "SF_X, scale factor of the X torquer.", "0.2 (deg/h)/(pulse/s)"
    )
    y: Quantity = key(
        QuantityLike("(deg/h)/(pulse/s)", "positive"), "SF_Y, scale factor of the Y torquer.", "0.2 (deg/h)/(pulse/s)"
    )


class Drift(Record):
    """Declares the bench-file keys for the drift of one axis: a constant part, and parts proportional to the specific force along
    each axis."""

    F: Quantity = key(QuantityOf("angular rate"), "Drift that does not depend on specific force.", "1.8 deg/h")
    X: Quantity = key(QuantityLike("deg/h/g"), "Drift proportional to specific force along X.", "3.2 deg/h/g")
    Y: Quantity = key(QuantityLike("deg/h/g"), "Drift proportional to specific force along Y.", "-2.1 deg/h/g")
    Z: Quantity = key(QuantityLike("deg/h/g"), "Drift proportional to specific force along Z.", "0.35 deg/h/g")


class VirtualFlexureGyroParameters(Record):
    """Declares the bench-file keys of a simulated flexure gyro, whose true parameters are known."""

    scale_factor: ScaleFactors = key(
        RecordOf(ScaleFactors),
        "Torquer scale factors.",
        {"x": "0.2 (deg/h)/(pulse/s)", "y": "0.2 (deg/h)/(pulse/s)"},
    )
    epsilon: Quantity = key(
        QuantityOf("angle"),
        "ε, angle of the torquer X axis to the case X axis.",
        "8 arcmin",
        default=parse_quantity("0 arcmin"),
    )
    xi: Quantity = key(
        QuantityOf("angle"),
        "ξ, angle of the torquer Y axis, in addition to ε.",
        "-5 arcmin",
        default=parse_quantity("0 arcmin"),
    )
    drift_x: Drift = key(
        RecordOf(Drift), "D(X).", {"F": "1.8 deg/h", "X": "3.2 deg/h/g", "Y": "-2.1 deg/h/g", "Z": "0.35 deg/h/g"}
    )
    drift_y: Drift = key(
        RecordOf(Drift), "D(Y).", {"F": "-1.2 deg/h", "X": "2.4 deg/h/g", "Y": "3.0 deg/h/g", "Z": "-0.28 deg/h/g"}
    )
    white_noise: Quantity = key(
        QuantityLike("pulse/sqrt(s)", "not negative"),
        "Random-walk coefficient N: the mean over T seconds scatters by N/√T.",
        "0.9 pulse/sqrt(s)",
        default=parse_quantity("0 pulse/sqrt(s)"),
    )
    bias_instability: Quantity | None = optional(
        QuantityLike("pulse/s", "not negative"),
        "Coefficient B of IEEE Std 952; the flat part of the Allan deviation is 0.664·B.",
        "0.025 pulse/s",
    )
    resolution: Quantity = key(
        QuantityLike("pulse/s", "not negative"),
        "Smallest step of an output; 0 for no quantisation.",
        "1 pulse/s",
        default=parse_quantity("0 pulse/s"),
    )
    full_scale: Quantity = key(
        QuantityLike("pulse/s", "positive"), "Largest output, for both signs.", "1000000 pulse/s"
    )
    sample_rate: Quantity = key(QuantityOf("frequency", "positive"), "Samples per second.", "100 Hz")
    thermal_lag: Quantity = key(
        QuantityOf("time", "positive"),
        "Time constant with which the gyro's temperature follows the air.",
        "10 min",
        default=parse_quantity("10 min"),
    )
    thermometer_noise: Quantity = key(
        QuantityOf("temperature", "not negative"),
        "Noise of one temperature reading.",
        "0.005 K",
        default=parse_quantity("0.005 K"),
    )


def _flicker(parameters: VirtualFlexureGyroParameters) -> float:
    """Returns the coefficient B of the flicker noise [pulse/s]. B is zero if the bench file does not state it."""
    return parameters.bias_instability.value if parameters.bias_instability is not None else 0.0


class VirtualFlexureGyro(OnlyRead):
    """A simulated flexure gyro on the virtual table."""

    role = "sensor"
    Parameters = VirtualFlexureGyroParameters

    def __init__(self, parameters: VirtualFlexureGyroParameters, world: World):
        self.parameters = parameters
        self.world = world
        self.flicker = {name: Flicker(_flicker(parameters)) for name in OUTPUTS}
        world.lags = replace(world.lags, sensor=parameters.thermal_lag.value)

    @classmethod
    def model(cls, parameters: VirtualFlexureGyroParameters) -> SensorModel:
        p = parameters
        stated = p.bias_instability is not None
        noise = NoiseModel(p.white_noise.value, _flicker(p), p.resolution.value, states_flicker=stated)
        rate = p.sample_rate.value
        thermometer = NoiseModel(p.thermometer_noise.value / math.sqrt(rate))
        torquers = tuple(OutputModel(name, "pulse/s", p.full_scale.value, noise) for name in OUTPUTS)
        nominal = {
            "SF_X": p.scale_factor.x.value,
            "SF_Y": p.scale_factor.y.value,
            "epsilon": p.epsilon.value,
            "xi": p.xi.value,
        }
        for axis, drift in (("X", p.drift_x), ("Y", p.drift_y)):
            parts = {"F": drift.F, "X": drift.X, "Y": drift.Y, "Z": drift.Z}
            nominal |= {f"D_{axis}_{part}": term.value for part, term in parts.items()}
        outputs = (*torquers, OutputModel(THERMOMETER, "degC", noise=thermometer))
        return SensorModel("flexure-gyro", outputs, rate, nominal, thermal_lag=p.thermal_lag.value)

    @classmethod
    def connect(cls, parameters: VirtualFlexureGyroParameters, surroundings: Surroundings) -> VirtualFlexureGyro:
        if abs(math.cos(parameters.xi.value)) < 1e-3:
            raise InstrumentError(
                "the gyro's torquers are along one axis (ξ is near 90 deg), so its loops cannot close"
            )
        from planrunner.instruments.virtual.world import World  # a check needs only the model

        return cls(parameters, World.of(surroundings))

    # -- what it does --------------------------------------------------------------------------------------------------

    def channels(self) -> Mapping[str, str]:
        return {**dict.fromkeys(OUTPUTS, "pulse/s"), THERMOMETER: "degC"}

    def stream(self, segment: Segment) -> Iterator[Block]:
        sampling = Sampling.of(self.world, segment, self.model(self.parameters))
        return sampling.blocks(self.world, self.sampler(sampling, generator(self.world.seed, segment.index)))

    def sampler(self, sampling: Sampling, draw: np.random.Generator) -> Callable[[int, int], Block]:
        """Returns a function that makes the samples of a sampling. This function takes `first` and `length`, and returns the
        samples first … first + length − 1. The function must be called for all samples, in order."""
        for flicker in self.flicker.values():
            flicker.begin(sampling.start, draw)
        return lambda first, length: self._block(sampling.times(first, length), sampling, draw)

    def read(self) -> Mapping[str, float]:
        kelvin = float(self.world.sensor(np.array([self.world.now()]))[0])
        return {f"{THERMOMETER}_degC": kelvin - ZERO_CELSIUS}

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": "virtual flexure gyro"}

    def checkpoint(self) -> Mapping[str, Json]:
        return {name: flicker.checkpoint() for name, flicker in self.flicker.items()}

    def restore(self, state: Mapping[str, Json]) -> None:
        for name, flicker in self.flicker.items():
            flicker.restore(float(state[name]["time"]), state[name]["state"])

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _block(self, time: Array, sampling: Sampling, draw: np.random.Generator) -> Block:
        """Makes the block of samples at the times `time`."""
        still = self.world.course.still(float(time[0]))
        length, rate, hold = time.size, sampling.rate, sampling.hold
        nodes = -(-length // hold)
        node_times = time[::hold]
        slow = [self.flicker[name].advance(nodes, hold / rate, draw) for name in OUTPUTS]
        levels = self.pulses(node_times if still else time)
        readings = {}
        for name, level, wander in zip(OUTPUTS, levels, slow, strict=True):
            felt = wander + level if still else level + np.repeat(wander, hold)[:length]
            readings[name] = self._readout(rate).samples(draw, felt, length, hold)
        celsius = self.world.sensor(node_times) - ZERO_CELSIUS
        readings[THERMOMETER] = Readout(self.parameters.thermometer_noise.value).samples(draw, celsius, length, hold)
        return Block(time, readings)

    def _readout(self, rate: float) -> Readout:
        p = self.parameters
        return Readout(p.white_noise.value * math.sqrt(rate), p.resolution.value, p.full_scale.value)

    def pulses(self, times: Array) -> tuple[Value, Value]:
        """Returns the torquer currents i_x, i_y [pulse/s] without noise at `times`: floats if the gyro is at rest, otherwise arrays
        (n,).

        The currents solve the two linear equations for the balance of the rotor. The right-hand side of these equations is linear
        in the input of the gyro.
        """
        p = self.parameters
        rates, forces = self.world.stimulus(times)
        slant = p.epsilon.value + p.xi.value
        torquers = np.array(
            [
                [p.scale_factor.y.value * math.cos(p.epsilon.value), -p.scale_factor.x.value * math.sin(slant)],
                [p.scale_factor.y.value * math.sin(p.epsilon.value), p.scale_factor.x.value * math.cos(slant)],
            ]
        )
        needed = np.linalg.inv(torquers)
        about_y = rates[1] + _drift(p.drift_x, forces)
        about_x = rates[0] + _drift(p.drift_y, forces)
        return needed[0, 0] * about_y + needed[0, 1] * about_x, needed[1, 0] * about_y + needed[1, 1] * about_x


def _drift(drift: Drift, forces: Components) -> Value:
    """Returns the drift [rad/s] of an axis under the specific forces [m/s²] along X, Y and Z."""
    return drift.F.value + drift.X.value * forces[0] + drift.Y.value * forces[1] + drift.Z.value * forces[2]
