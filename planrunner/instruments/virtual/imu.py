"""Simulates an inertial sensor: gyros and accelerometers on the table of the virtual world. The gyros and accelerometers integrate
their input.

A sample is the mean over its sampling interval; its time is the end of the interval. The error model is in `inertial_axis.py`. The
error model has no formula in common with the estimators."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import InputError
from planrunner.instruments.interfaces import Block, InstrumentError, Surroundings, TakesEffects
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.virtual.added import Gives, Moments
from planrunner.instruments.virtual.averages import interval_means
from planrunner.instruments.virtual.courses import Rocking, Spinning
from planrunner.instruments.virtual.imu_keys import VirtualImuParameters
from planrunner.instruments.virtual.inertial_axis import InertialAxis, axes_of
from planrunner.instruments.virtual.noise import Flicker, PulseCounter, RandomWalk, Readout, generator
from planrunner.instruments.virtual.streaming import Sampling
from planrunner.instruments.virtual.world import Components, World
from planrunner.physics.table_motion import about_one_axis
from planrunner.plan.schedule import Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS, unit

if TYPE_CHECKING:
    from planrunner.instruments.virtual.world import World

THERMOMETER = "sensor_temperature"
VOLTMETER = "supply_voltage"
BAROMETER = "ambient_pressure"
ATMOSPHERE = 101325.0  # Pa
ENCODER = "table_angle"
REFERENCE = {
    "reference_latitude": "deg",
    "reference_longitude": "deg",
    "reference_height": "m",
    "reference_velocity_east": "m/s",
    "reference_velocity_north": "m/s",
}
MODES = ("powered", "unpowered")
_SWITCH_ON = 1  # second part of the key of a generator; the keys of segments have only one part


@dataclass(frozen=True, slots=True)
class _Dwell:
    """State of the sensor while one segment is recorded. `chances`: array of shape (axes, 2), random numbers that are drawn at
    switch-on, for the repeatability of bias and scale factor. `counters`: pulse counters of the outputs that count pulses."""

    segment: Segment | None
    sampling: Sampling
    draw: np.random.Generator
    chances: Array
    counters: Mapping[str, PulseCounter]


class VirtualImu(TakesEffects):
    """A simulated inertial sensor."""

    role = "sensor"
    Parameters = VirtualImuParameters

    def __init__(self, parameters: VirtualImuParameters, world: World):
        self.parameters = parameters
        self.world = world
        self.axes = axes_of(parameters)
        self.flicker = {axis.name: Flicker(axis.bias_instability) for axis in self.axes}
        self.walk = {axis.name: RandomWalk(axis.walk) for axis in self.axes}
        self.powered = True
        self.switched_on = 0.0
        self.times_switched_on = 0
        world.lags = replace(world.lags, sensor=parameters.thermal_lag.value)

    @classmethod
    def model(cls, parameters: VirtualImuParameters) -> SensorModel:
        if parameters.gyros is None and parameters.accelerometers is None:
            message = "the sensor has neither 'gyros' nor 'accelerometers'"
            hint = "add for example `gyros: {axes: {x: {}, y: {}, z: {}}}`"
            raise InputError.at(parameters.origin.mark, "form-missing-key", message, hint)
        rate = parameters.sample_rate.value
        axes = axes_of(parameters)
        thermometer = NoiseModel(parameters.thermometer_noise.value / math.sqrt(rate))
        reference = REFERENCE if parameters.reference else {}
        outputs = (
            *(axis.output(rate) for axis in axes),
            OutputModel(THERMOMETER, "degC", noise=thermometer),
            *_monitors(parameters),
            *([OutputModel(ENCODER, "deg", constant=True)] if parameters.table_angle else []),
            *(OutputModel(name, text, constant=True) for name, text in reference.items()),
        )
        nominal = {f"K_{axis.name}": axis.scale_factor for axis in axes}
        lag = parameters.thermal_lag.value
        return SensorModel(
            parameters.kind,
            outputs,
            rate,
            nominal,
            MODES,
            thermal_lag=lag,
            records_angle=parameters.table_angle,
            nominal_supply=parameters.nominal_supply.value,
        )

    @classmethod
    def connect(cls, parameters: VirtualImuParameters, surroundings: Surroundings) -> VirtualImu:
        return cls(parameters, World.of(surroundings))

    # -- what it does --------------------------------------------------------------------------------------------------

    def channels(self) -> Mapping[str, str]:
        reference = REFERENCE if self.parameters.reference else {}
        encoder = {ENCODER: "deg"} if self.parameters.table_angle else {}
        monitors = {one.name: one.unit for one in _monitors(self.parameters)}
        return {**{axis.name: axis.unit for axis in self.axes}, THERMOMETER: "degC", **monitors, **encoder, **reference}

    def set_mode(self, mode: str) -> float:
        if mode not in MODES:
            raise InstrumentError(f"the virtual IMU has no mode '{mode}'; its modes are {' and '.join(MODES)}")
        if mode == "powered" and not self.powered:
            self.times_switched_on += 1
            self.switched_on = self.world.now()
        self.powered = mode == "powered"
        return 0.0

    def stream(self, segment: Segment) -> Iterator[Block]:
        sampling = Sampling.of(self.world, segment, self.model(self.parameters))
        draw = generator(self.world.seed, segment.index)
        return sampling.blocks(self.world, self.sampler(sampling, draw, segment))

    def sampler(
        self, sampling: Sampling, draw: np.random.Generator, segment: Segment | None = None
    ) -> Callable[[int, int], Block]:
        """Returns a function that makes the samples first … first + length − 1 of a sampling. The function must be called for all
        samples, in order.

        Raises `InstrumentError` if the outputs depend on the motion of the segment but no segment is given.
        """
        if segment is None and (self.parameters.table_angle or self.world.added is not None):
            raise InstrumentError(
                "a free-running sensor has no table angle and does not support added effects: leave them out"
            )
        for axis in self.axes:
            self.flicker[axis.name].begin(sampling.start, draw)
            self.walk[axis.name].begin(sampling.start, draw)
        counters = {
            axis.name: PulseCounter(axis.step_of_sample(sampling.rate))
            for axis in self.axes
            if axis.counted and axis.step
        }
        chances = generator(self.world.seed, self.times_switched_on, _SWITCH_ON).standard_normal((len(self.axes), 2))
        dwell = _Dwell(segment, sampling, draw, chances, counters)
        return lambda first, length: self._block(dwell, first, length)

    def read(self) -> Mapping[str, float]:
        kelvin = float(self.world.sensor(np.array([self.world.now()]))[0])
        return {f"{THERMOMETER}_degC": kelvin - ZERO_CELSIUS}

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": f"virtual {self.parameters.kind}"}

    def checkpoint(self) -> Mapping[str, Json]:
        return {
            "powered": self.powered,
            "switched_on": self.switched_on,
            "times_switched_on": self.times_switched_on,
            "flicker": {name: flicker.checkpoint() for name, flicker in self.flicker.items()},
            "walk": {name: walk.checkpoint() for name, walk in self.walk.items()},
        }

    def restore(self, state: Mapping[str, Json]) -> None:
        self.powered = bool(state["powered"])
        self.switched_on = float(state["switched_on"])
        self.times_switched_on = int(state["times_switched_on"])
        for name, flicker in self.flicker.items():
            flicker.restore(**state["flicker"][name])
        for name, walk in self.walk.items():
            walk.restore(**state["walk"][name])

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _block(self, dwell: _Dwell, first: int, length: int) -> Block:
        """Makes the block of samples first … first + length − 1. Temperature and slow noise are evaluated once per second, in the
        middle of the second."""
        sampling = dwell.sampling
        middles = sampling.middles(first, length)
        kelvin = self.world.sensor(middles)
        if self.powered:
            means = interval_means(self.world, sampling, first, length)
            if self.world.added is None:
                readings = {
                    axis.name: self._samples(
                        axis, dwell, self._level(axis, chance, dwell, means, kelvin, middles), length
                    )
                    for axis, chance in zip(self.axes, dwell.chances, strict=True)
                }
            else:
                readings = self._with_added(dwell, means, kelvin, middles, first, length)
        else:
            readings = {axis.name: np.zeros(length) for axis in self.axes}
        thermometer = Readout(self.parameters.thermometer_noise.value)
        readings[THERMOMETER] = thermometer.samples(dwell.draw, kelvin - ZERO_CELSIUS, length, sampling.hold)
        for name, noise, value in self._monitored(dwell.segment):
            readings[name] = value + noise * dwell.draw.standard_normal(length)
        time = sampling.times(first, length, delay=1)
        if self.parameters.table_angle and dwell.segment is not None:
            readings[ENCODER] = np.degrees(mean_angle(self.world, dwell.segment, time, 1 / sampling.rate))
        if self.parameters.reference:
            truth = zip(REFERENCE.items(), self.world.position(time), strict=True)
            readings |= {name: np.broadcast_to(value / unit(text).factor, length) for (name, text), value in truth}
        return Block(time, readings)

    def _excess(self, segment: Segment | None) -> tuple[float, float]:
        """Returns the supply voltage [V] above its nominal value and the pressure [Pa] above the standard atmosphere; zero for a
        quantity that the segment does not state."""
        voltage = None if segment is None else segment.supply_voltage
        pressure = None if segment is None else segment.ambient_pressure
        return (
            0.0 if voltage is None else voltage - self.parameters.nominal_supply.value,
            0.0 if pressure is None else pressure - ATMOSPHERE,
        )

    def _monitored(self, segment: Segment | None) -> Iterator[tuple[str, float, float]]:
        """Yields name, noise and value of the supply [V] and of the pressure [hPa], if they are recorded."""
        volts, pascals = self._excess(segment)
        voltmeter, barometer = self.parameters.voltmeter_noise, self.parameters.barometer_noise
        if voltmeter is not None:
            yield VOLTMETER, voltmeter.value, self.parameters.nominal_supply.value + volts
        if barometer is not None:
            yield BAROMETER, barometer.value / 100, (ATMOSPHERE + pascals) / 100

    def _level(
        self,
        axis: InertialAxis,
        chance: Array,
        dwell: _Dwell,
        means: tuple[Components, Components],
        kelvin: Array,
        middles: Array,
    ) -> Array:
        """Returns the output of one axis without white noise, computed from mean rates and forces over the sampling intervals.
        `kelvin`, `middles`: temperature [K] and time [s] in the middle of every second. `chance`: array of shape (2,), random
        numbers for the repeatability of bias and scale factor. `means`: mean rates [rad/s] and forces [m/s²]."""
        sampling, draw = dwell.sampling, dwell.draw
        step = sampling.hold / sampling.rate
        off = kelvin - self.parameters.reference_temperature.value
        shift, gain = axis.by_surroundings(*self._excess(dwell.segment))
        drift = axis.drift(off, middles - self.switched_on, axis.bias_repeatability * chance[0] + shift)
        drift = drift + self.flicker[axis.name].advance(off.size, step, draw)
        drift += self.walk[axis.name].advance(off.size, step, draw)
        scale = axis.scale(off, axis.error_repeatability * chance[1] + gain)
        return axis.level(axis.felt(*means), drift, scale, sampling.hold)

    def _samples(
        self, axis: InertialAxis, dwell: _Dwell, level: Array, length: int, gives: Gives | None = None
    ) -> Array:
        """Draws `length` samples of one axis around its level. `gives`: noise of the output, by default the declared noise."""
        sampling = dwell.sampling
        gives = gives or self._gives(axis, sampling)
        sigma = gives.white * math.sqrt(sampling.rate)
        readout = Readout(sigma, 0.0 if axis.counted else gives.step, axis.full_scale * axis.nominal)
        samples = readout.samples(dwell.draw, level, length, sampling.hold)
        if axis.name in dwell.counters:
            dwell.counters[axis.name].count(samples)
        return samples

    @staticmethod
    def _gives(axis: InertialAxis, sampling: Sampling) -> Gives:
        return Gives(axis.unit, axis.white * axis.nominal, axis.step_of_sample(sampling.rate))

    def _with_added(
        self,
        dwell: _Dwell,
        means: tuple[Components, Components],
        kelvin: Array,
        middles: Array,
        first: int,
        length: int,
    ) -> dict[str, Array]:
        """Returns the samples of all axes, after effects have been added to their levels and to their noise. The other arguments
        are the same as in `_level` and `sampler`."""
        added, sampling = self.world.added, dwell.sampling
        assert added is not None and dwell.segment is not None
        hold = sampling.hold
        levels = {}
        for axis, chance in zip(self.axes, dwell.chances, strict=True):
            level = self._level(axis, chance, dwell, means, kelvin, middles)
            levels[axis.name] = level if level.size == length else np.repeat(level, hold)[:length]
        step = 1 / sampling.rate
        end = sampling.times(first, length, delay=1)
        time = end - 0.5 * step
        before, after = (turned(self.world, dwell.segment, edges) for edges in (end - step, end))
        rate, acceleration = ((late - early) / step for early, late in zip(before, after, strict=True))
        warm = self.world.sensor(time)
        volts, pascals = (np.full(length, value) for value in self._excess(dwell.segment))
        moments = Moments(
            dwell.segment,
            time,
            self.switched_on,
            sampling.rate,
            mean_angle(self.world, dwell.segment, end, step),
            rate,
            acceleration,
            warm,
            overvoltage=volts,
            overpressure=pascals,
        )
        gives = {axis.name: self._gives(axis, sampling) for axis in self.axes}
        changed = added.levels(moments, levels, gives)
        samples = {
            axis.name: self._samples(axis, dwell, changed[axis.name], length, added.noise(axis.name, gives[axis.name]))
            for axis in self.axes
        }
        return dict(added.readings(moments, samples))


def _monitors(parameters: VirtualImuParameters) -> list[OutputModel]:
    """Returns the models of the recorded supply voltage and ambient pressure; empty if neither is recorded."""
    root = math.sqrt(parameters.sample_rate.value)
    found = []
    if parameters.voltmeter_noise is not None:
        found.append(OutputModel(VOLTMETER, "V", noise=NoiseModel(parameters.voltmeter_noise.value / root)))
    if parameters.barometer_noise is not None:
        found.append(OutputModel(BAROMETER, "hPa", noise=NoiseModel(parameters.barometer_noise.value / 100 / root)))
    return found


def turned(world: World, segment: Segment, times: Array) -> tuple[Array, Array]:
    """Returns the angle [rad] by which the table has turned since the orientation was reached, and the rate of this angle [rad/s].
    Both arrays have the shape (n,). The angle and the rate are about the axis of the segment's motion; they are zero if the table
    neither spins nor rocks.

    Raises `InstrumentError` if several rings rock.
    """
    course, motion = world.course, segment.motion
    if isinstance(motion, Spin) and isinstance(course, Spinning):
        joint, sense = course.joint, math.copysign(1.0, motion.rate) * math.copysign(1.0, course.rate)
    elif isinstance(motion, Rock) and isinstance(course, Rocking):
        joint, sense = 0, 1.0
        if not about_one_axis(motion):
            raise InstrumentError(f"'{segment.label}' rocks several rings, so there is no table angle about one axis")
    else:
        return np.zeros(len(times)), np.zeros(len(times))
    angle, rate = (np.broadcast_to(value, times.shape) for value in course.follow(times)[joint])
    return sense * (angle - course.angles[joint]), sense * rate


def mean_angle(world: World, segment: Segment, times: Array, interval: float) -> Array:
    """Returns the mean angle [rad] over each sampling interval that ends at one of `times` (n,), s. The outputs are means over the
    same intervals. `interval`: length of these intervals, s."""
    places, weights = np.polynomial.legendre.leggauss(3)
    total = np.zeros(len(times))
    for place, weight in zip(places, weights, strict=True):
        total += weight / 2 * turned(world, segment, times + (place - 1) / 2 * interval)[0]
    return total
