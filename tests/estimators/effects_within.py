"""Recordings of gyros and accelerometers with effects that live within segments, played through the estimator `error_model`.

`python tests/estimators/effects_within.py SEEDS [WORLD …]` prints coverage and scatter of each coefficient.

The recordings come from `tests.blind`, whose formulas are its own: attitudes stepped in time, lags by quadrature over the past.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from recorded import from_samples
from scipy.stats import t as student

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.error_model.estimator import ErrorModelEstimator
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, Setup
from planrunner.estimators.method import designed
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan import schedule as planned
from planrunner.uncertainty.influences import Aspect, InputQuantity, Inputs
from tests.blind.device import Device, Sensor, Triad, clean_output
from tests.blind.motion import Fault, Schedule, vector
from tests.blind.noise import noise
from tests.blind.plans import Axes, Segment

SITE = Site(np.radians(39.98), 9.80154, azimuth=0.0)
NAMES = tuple(f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz")
UNITS = {name: "deg/s" if name.startswith("gyro") else "m/s^2" for name in NAMES}
GYRO = ("gyro_bias", "gyro_scale_factor", "gyro_misalignment")
TRIAD, STEADY = Triad(0.002, 0.0, 0.0), Triad(50e-6 * 9.80665, 0.0, 0.0)
SENSOR = Sensor("under test", 50.0, TRIAD, STEADY)


def _axes(text: str) -> Axes:
    x, y, z = text.split()
    return x, y, z


def statics(seconds: float = 30.0) -> list[Segment]:
    """Six cardinal orientations at rest."""
    axes = ("up north west", "down north east", "north up east", "south down east", "east north up", "west north down")
    return [Segment(f"S{n}", "static", _axes(one), seconds) for n, one in enumerate(axes)]


def rates(*steps: float, seconds: float = 12.0) -> list[Segment]:
    """About each axis, in both directions."""
    found = []
    for axis, axes in {"x": "up north west", "y": "north up east", "z": "north west up"}.items():
        for rate in steps:
            for sign in (1, -1):
                label = f"R{axis}{sign * rate:g}"
                found.append(Segment(label, "rate", _axes(axes), seconds, rate=sign * rate))
    return found


def rocks(*pairs: tuple[float, float], seconds: float = 21.3) -> list[Segment]:
    """About each axis, amplitudes in deg and frequencies in Hz; not for whole periods."""
    found = []
    for axis, axes in {"x": "up north west", "y": "north up east", "z": "north west up"}.items():
        for amplitude, frequency in pairs:
            label = f"K{axis}{frequency:g}"
            found.append(Segment(label, "rock", _axes(axes), seconds, amplitude=amplitude, frequency=frequency))
    return found


def timed(segments: Sequence[Segment], begin: float = 60.0, pause: float = 15.0) -> list[Segment]:
    """One after the other."""
    found, time = [], begin
    for one in segments:
        found.append(replace(one, start=time))
        time += one.duration + pause
    return found


def _planned(number: int, one: Segment) -> planned.Segment:
    motion: planned.Motion = planned.Rest()
    if one.kind == "rate":
        motion = planned.Spin(float(np.radians(one.rate)))
    elif one.kind == "rock":
        motion = planned.Rock(float(np.radians(one.amplitude)), one.frequency, (0.0,), one.duration)
    attitude = np.array([vector(axis) for axis in one.axes], dtype=float)
    words, kelvin = " ".join(map(str, one.axes)), one.chamber + 273.15
    return planned.Segment(
        number, one.label, attitude, words, motion, one.duration, temperature=kelvin, start=one.start
    )


@dataclass(frozen=True)
class World:
    """Segments with a device and faults. flicker: bias instability of the gyros, deg/s; spread: standard deviation of the
    device's scale factors and misalignments; noisy: factor of the white noise, declared and real."""

    segments: Sequence[Segment]
    faults: Mapping[str, Fault]
    outputs: Mapping[str, Sequence[str]]
    expected: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    flicker: float = 0.0
    basis: str = "residual"
    noisy: float = 1.0
    site: Site = SITE
    drift: tuple[str, ...] = ("by_evidence",)
    spread: float = 3e-3

    @cached_property
    def schedule(self) -> Schedule:
        return Schedule(tuple(self.segments), SENSOR.sampling)

    @cached_property
    def sensor(self) -> Sensor:
        gyro = replace(TRIAD, white=self.noisy * TRIAD.white, instability=self.flicker)
        return replace(SENSOR, gyro=gyro, accel=replace(STEADY, white=self.noisy * STEADY.white))

    @property
    def model(self) -> SensorModel:
        outputs = []
        for name in NAMES:
            triad = self.sensor.gyro if name.startswith("gyro") else self.sensor.accel
            assert triad is not None
            declared = NoiseModel(white=triad.white / np.sqrt(2), bias_instability=triad.instability)
            outputs.append(OutputModel(name, UNITS[name], noise=declared))
        return SensorModel("under-test", tuple(outputs), SENSOR.sampling)

    @property
    def setup(self) -> Setup:
        names = [Aspect.BIAS_INSTABILITY.of(name) for name in NAMES[:3]] if self.flicker else []
        width = float(np.radians(self.flicker))
        return Setup(
            inputs=Inputs({name: InputQuantity(name, 0.0, "deg/s", self.flicker) for name in names} if width else {})
        )

    @property
    def parameters(self) -> ErrorModelParameters:
        stated = {effect: dict(values) for effect, values in self.expected.items()}
        named = {output: tuple(effects) for output, effects in self.outputs.items()}
        return ErrorModelParameters(outputs=named, expected=stated, uncertainty=self.basis, drift=self.drift)

    def device(self, seed: int) -> Device:
        draw = np.random.default_rng([seed, 1])
        errors = self.spread * draw.standard_normal((2, 3, 3))
        return Device(np.eye(3) + errors, 0.05 * draw.standard_normal((2, 3)))

    def recording(self, seed: int) -> list[RecordedSegment]:
        clean = clean_output(self.schedule, self.sensor, self.device(seed), self.faults)
        drawn = noise(self.schedule, self.sensor, np.ones(6), np.random.default_rng([seed, 2]))
        values = clean + drawn
        found = []
        for number, one in enumerate(self.segments):
            rows = self.schedule.index == number
            time = self.schedule.time[rows]
            channels = {name: values[rows, k] for k, name in enumerate(NAMES)}
            found.append(from_samples(_planned(number, one), time, channels, UNITS))
        return found

    def estimate(self, seed: int) -> Estimate:
        return self.estimate_of(self.recording(seed))

    def estimate_of(self, recording: Sequence[RecordedSegment]) -> Estimate:
        request = EstimateRequest("model", tuple(recording), self.parameters, self.site, self.model, setup=self.setup)
        return ErrorModelEstimator().estimate(request)

    def design(self) -> DesignRequest[ErrorModelParameters]:
        segments = tuple(_planned(number, one) for number, one in enumerate(self.segments))
        return DesignRequest("model", segments, self.parameters, self.site, self.model, setup=self.setup)


def single(effect: str, *theta: float, shape: tuple[float, ...] = ()) -> dict[str, Fault]:
    return {effect: Fault(effect, np.array(theta), shape)}


def truth(world: World, seed: int) -> dict[str, float]:
    """Coefficient → value in the unit that it is reported in."""
    device, faults, found = world.device(seed), world.faults, dict[str, float]()
    arcsec, g = 3600 * np.degrees(1.0), 9.80665
    for i, a in enumerate("xyz"):
        found[f"gyro_bias_{a}"] = device.biases[0, i]
        found[f"accel_bias_{a}"] = device.biases[1, i] / g * 1e3
        for k, kind in enumerate(("gyro", "accel")):
            found[f"{kind}_scale_factor_{a}"] = (device.matrices[k, i, i] - 1) * 1e6
            for j, b in enumerate("xyz"):
                found[f"{kind}_misalignment_towards_{b}_{a}"] = device.matrices[k, i, j] * arcsec
    for name, fault in faults.items():
        size = [float(one) for one in fault.theta]
        match name:
            case "gyro_bandwidth":
                found["gyro_bandwidth_tau_x"] = size[0]
            case "time_latency":
                found["time_latency_delay"] = size[0]
            case "gyro_dead_zone":
                found["gyro_dead_zone_d_x"] = size[0]
            case "gyro_saturation":
                rest = {other: one for other, one in faults.items() if other != name}
                rates = clean_output(world.schedule, world.sensor, device, rest)[:, :3]
                found["gyro_saturation_limit_x"] = float(np.abs(rates).max()) - size[0]
            case "table_rate_ripple":  # angle + (p·sin nθ + q·cos nθ)/n
                found["table_rate_ripple_cos"], found["table_rate_ripple_sin"] = size[0] * 1e6, -size[1] * 1e6
            case "lever_arm":
                found |= {f"lever_arm_r_{a}_accel_x": 1e3 * one for a, one in zip("xyz", size, strict=True)}
            case "gyro_warm_up":
                found["gyro_warm_up_tau_x"], found["gyro_warm_up_a_x"] = fault.shape[0], size[0]
    return found


_PLAIN = ("gyro_bias", "gyro_scale_factor")
_ROCKED = timed([*statics(), *rates(50, seconds=7.2), *rocks((8, 0.5), (2, 4), seconds=8.3)])
_TURNED = timed([*statics(), *rates(50, 100, 200, seconds=7.2)])
_LAG, _WARM = single("gyro_bandwidth", 8e-3), single("gyro_warm_up", 0.05, 0.03, 0.02, shape=(400.0,))
_OFTEN = [*statics(), *rates(50, seconds=7.2), *rocks((8, 0.5), seconds=8.3), *statics(), *statics()]
WORLDS = {
    "lag": World(_ROCKED, _LAG, {"gyro_x": (*GYRO, "gyro_bandwidth")}, {"gyro_bandwidth": {"tau": "8 ms"}}),
    "delay": World(
        _ROCKED,
        single("time_latency", 5e-3),
        {"gyro_x": (*GYRO, "time_latency")},
        {"time_latency": {"delay": "5 ms"}},
    ),
    "ripple": World(
        _TURNED, single("table_rate_ripple", 2e-3, -1e-3, shape=(2.0,)), {"gyro_x": (*GYRO, "table_rate_ripple")}
    ),
    "dead zone": World(
        timed([*statics(), *(one for one in rates(0.5, 1, 2, 50, seconds=7.2) if one.label.startswith("Rx"))]),
        single("gyro_dead_zone", 0.4),
        {"gyro_x": (*_PLAIN, "gyro_dead_zone")},
        {"gyro_dead_zone": {"d": "0.4 deg/s"}},
    ),
    "limit": World(
        _TURNED,
        single("gyro_saturation", 30.0),
        {"gyro_x": (*GYRO, "gyro_saturation")},
        {"gyro_saturation": {"limit": "170 deg/s"}},
    ),
    "lever arm": World(
        timed([*statics(), *rocks((8, 0.5), (2, 4), seconds=8.3)]),
        single("lever_arm", 0.03, -0.02, 0.04),
        {"accel_x": ("accel_bias", "accel_scale_factor", "accel_misalignment", "lever_arm")},
    ),
    "lag and warm-up": World(
        timed(_OFTEN),
        {**_LAG, **_WARM},
        {"gyro_x": (*GYRO, "gyro_bandwidth", "gyro_warm_up")},
        {"gyro_bandwidth": {"tau": "8 ms"}, "gyro_warm_up": {"tau": "400 s", "a_x": "0.05 deg/s"}},
    ),
}


@dataclass(frozen=True)
class Found:
    """Of one coefficient over some seeds: share of the 95 % intervals that contain the true value, scatter of the errors, root mean
    square of the standard uncertainties, and the predicted one, in the coefficient's unit."""

    covered: float
    scatter: float
    stated: float
    predicted: float


def campaign(
    world: World, seeds: Sequence[int], true_values: Callable[[World, int], Mapping[str, float]] = truth
) -> dict[str, Found]:
    """By coefficient."""
    errors: dict[str, list[tuple[float, float, bool]]] = {}
    for seed in seeds:
        true = true_values(world, seed)
        for own in world.estimate(seed).coefficients:
            error, u = own.value - true[own.name], own.standard_uncertainty
            inside = abs(error) < float(student.ppf(0.975, own.degrees_of_freedom)) * u
            errors.setdefault(own.name, []).append((error, u, inside))
    expected = {one.name: one.standard_uncertainty for one in designed(ErrorModelEstimator(), world.design()).predicted}
    found = {}
    for name, rows in errors.items():
        table = np.array(rows, dtype=float)
        scatter, stated = np.sqrt(np.mean(table[:, :2] ** 2, axis=0)).tolist()
        found[name] = Found(float(table[:, 2].mean()), scatter, stated, expected.get(name, np.nan))
    return found


def main(words: Sequence[str]) -> None:
    for name in words[1:] or WORLDS:
        for coefficient, one in campaign(WORLDS[name], range(1, 1 + int(words[0]))).items():
            ratios = (
                f"scatter ÷ predicted {one.scatter / one.predicted:.2f}, u ÷ predicted {one.stated / one.predicted:.2f}"
            )
            print(f"{name}: {coefficient} covered {100 * one.covered:.1f} %, {ratios}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
