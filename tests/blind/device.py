"""The true device: sensor and output stages, noise, outliers, resolution. Outputs are °/s for gyros and m/s² for accelerometers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.motion import Array, Fault, Faults, Schedule, Stimulus, behind, stimulus

ACCELERATION_STEP = 1e-3  # s
LAG_NODES = 8  # of the Gauss–Laguerre rule for a first-order lag


@dataclass(frozen=True)
class Triad:
    """Declared noise: one-sided density in unit/√Hz, IEEE bias instability B in unit (two-sided density B²/(2πf)), resolution."""

    white: float
    instability: float
    resolution: float


@dataclass(frozen=True)
class Sensor:
    """A sensor type; `accel` is None for a triad of gyros alone."""

    name: str
    sampling: float
    gyro: Triad
    accel: Triad | None
    wrapped: bool = False  # the encoder's column runs from 0 to 360
    real: bool = False  # its noise is that of a recording
    counts: tuple[float, ...] = ()  # resolution of each channel, where those of a triad differ

    @property
    def triads(self) -> tuple[Triad, ...]:
        return (self.gyro,) if self.accel is None else (self.gyro, self.accel)

    def sigma(self) -> Array:
        """White standard deviation of a sample, per channel."""
        return np.repeat([t.white * np.sqrt(self.sampling / 2) for t in self.triads], 3)


SENSORS = {
    "mems": Sensor("mems", 50.0, Triad(0.002, 0.0, 5e-4), Triad(50e-6 * 9.80665, 0.0, 20e-6 * 9.80665)),
    "fog": Sensor("fog", 20.0, Triad(2.5e-4, 1.5e-5, 1e-6), None, wrapped=True),
}


@dataclass(frozen=True)
class Device:
    """What is nominal but unknown: a matrix near identity and a bias per triad, shapes (triads, 3, 3) and (triads, 3)."""

    matrices: Array
    biases: Array


def ideal(sensor: Sensor) -> Device:
    n = len(sensor.triads)
    return Device(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))


def random_device(sensor: Sensor, rng: np.random.Generator) -> Device:
    n = len(sensor.triads)
    scale = np.array([0.1, 0.05])[:n, None]
    return Device(np.eye(3) + 3e-3 * rng.standard_normal((n, 3, 3)), scale * rng.standard_normal((n, 3)))


def walk(time: Array, seed: float) -> Array:
    """A random walk of unit variance a second for three axes, at the sample times, from zero at the first."""
    steps = np.sqrt(np.diff(time, prepend=time[0]))[:, None]
    return np.cumsum(steps * np.random.default_rng(int(seed)).standard_normal((len(time), 3)), axis=0)


def _bursts(time: Array, seed: float) -> Array:
    """Windows of 1 to 6 s, one in some 60 s on average, in which a carrier of 3 to 8 Hz is picked up; peak 1."""
    rng = np.random.default_rng(int(seed))
    found = np.zeros_like(time)
    for start in rng.uniform(time[0], time[-1], max(4, int((time[-1] - time[0]) / 60))):
        length, frequency, phase = rng.uniform(1, 6), rng.uniform(3, 8), rng.uniform(0, 6.28)
        inside = (time >= start) & (time < start + length)
        found[inside] += 1 + np.sin(2 * np.pi * frequency * time[inside] + phase)
    return found / 2


def _catalogue_rate(s: Stimulus, faults: Faults) -> Array:
    """What the effects of the catalogue add to the gyro's output, °/s."""
    warm = s.temperature[:, None] - 25
    f, w = s.force, s.rate
    pairs = np.stack([f[:, 0] * f[:, 1], f[:, 1] * f[:, 2], f[:, 2] * f[:, 0]], 1)
    added = np.zeros_like(w)
    for name, fault in faults.items():
        k = fault.theta
        match name:
            case "gyro_bias_temperature":
                added += k[:3] * warm + k[3:] * warm**2
            case "gyro_scale_temperature":
                added += k * warm * w
            case "gyro_scale_nonlinearity":
                added += k * w**3
            case "gyro_scale_quadratic":
                added += k * w**2
            case "gyro_scale_asymmetry":
                added += k * np.abs(w)
            case "gyro_bias_temperature_cubic":
                added += k * warm**3
            case "gyro_misalignment_temperature":
                added += warm * (w @ k.reshape(3, 3).T)
            case "gyro_bias_drift":
                added += k * s.time[:, None]
            case "gyro_g_sensitivity":
                added += f @ k.reshape(3, 3).T
            case "gyro_g2_sensitivity":
                added += np.hstack([f**2, pairs]) @ k.reshape(3, 6).T
            case "gyro_bias_random_walk":
                added += k * walk(s.time, fault.shape[0])
            case "gyro_warm_up":
                added += k * np.exp(-s.time / fault.shape[0])[:, None]
            case "gyro_thermal_hysteresis":
                added += k * s.last_change[:, None]
            case "gyro_thermal_gradient":
                added += k * s.temperature_rate[:, None]
            case "gyro_bias_step":
                added += k * np.heaviside(s.time - fault.shape[0], 1.0)[:, None]
            case "magnetic_sensitivity":
                added += s.field @ k.reshape(3, 3).T
            case "gyro_line_interference":
                added += k * _hum(s.time, *fault.shape)[:, None]
    return added


def _hum(time: Array, frequency: float, phase: float) -> Array:
    """A rotating phasor of unit length, seen from the side at the times of the samples."""
    turns = np.mod(frequency * time, 1.0)
    return np.imag(np.exp(1j * (2 * np.pi * turns + phase)))


def _foreign_rate(s: Stimulus, faults: Faults, number: Array) -> Array:
    """What effects off the catalogue add to the gyro's output, °/s; `number` is the segment of each sample."""
    added = np.zeros_like(s.rate)
    for name, fault in faults.items():
        k, shape = fault.theta, fault.shape
        match name:
            case "vibration_tone":
                added += k * np.sin(2 * np.pi * shape[0] * s.time + shape[1])[:, None]
            case "sawtooth_bias":
                added += k * np.mod(s.time / shape[0], 1.0)[:, None]
            case "rate_resonance":
                bump = np.exp(-0.5 * ((np.abs(s.rate) - shape[0]) / (0.2 * shape[0])) ** 2)
                added += k * bump
            case "temperature_rate_times_rate":
                added += k * s.temperature_rate[:, None] * s.rate
            case "emi_bursts":
                added += k * _bursts(s.time, shape[0])[:, None]
            case "slow_sine_bias":
                added += k * np.sin(2 * np.pi * s.time / shape[0] + shape[1])[:, None]
            case "segment_offsets":
                added += k * np.random.default_rng(int(shape[0])).standard_normal((number[-1] + 1, 1))[number]
            case "magnetic_times_temperature":
                added += k * (s.field[:, :1] * (s.temperature[:, None] - 25))
    return added


def _gyro(s: Stimulus, device: Device, faults: Faults, number: Array) -> Array:
    felt = s.rate @ device.matrices[0].T + device.biases[0]
    return felt + _catalogue_rate(s, faults) + _foreign_rate(s, faults, number)


def _accel(s: Stimulus, device: Device, faults: Faults, gravity: float) -> Array:
    felt = s.force @ device.matrices[1].T * gravity + device.biases[1]
    warm = s.temperature[:, None] - 25
    for name, fault in faults.items():
        match name:
            case "accel_bias_temperature":
                felt = felt + fault.theta * warm
            case "accel_scale_temperature":
                felt = felt + fault.theta * warm * s.force * gravity
            case "accel_second_order":
                felt = felt + fault.theta * s.force**2
            case "accel_third_order":
                felt = felt + fault.theta * s.force**3
            case "accel_asymmetry":
                felt = felt + fault.theta * np.abs(s.force) * gravity
            case "accel_cross_coupling":
                x, y, z = s.force.T
                felt = felt + np.stack([x * y, y * z, z * x], 1) @ fault.theta.reshape(3, 3).T
            case "accel_misalignment_temperature":
                felt = felt + warm * (s.force @ fault.theta.reshape(3, 3).T) * gravity
            case "accel_bias_drift":
                felt = felt + fault.theta * s.time[:, None]
            case "accel_magnetic_sensitivity":
                felt = felt + s.field @ fault.theta.reshape(3, 3).T
            case "accel_thermal_hysteresis":
                felt = felt + fault.theta * s.last_change[:, None]
            case "accel_warm_up":
                felt = felt + fault.theta * np.exp(-s.time / fault.shape[0])[:, None]
            case "accel_bias_step":
                felt = felt + fault.theta * np.heaviside(s.time - fault.shape[0], 1.0)[:, None]
            case "accel_line_interference":
                felt = felt + fault.theta * _hum(s.time, *fault.shape)[:, None]
            case "vibration_rectification":
                felt = felt + fault.theta * np.linalg.norm(s.table_rate, axis=1)[:, None]
    return felt


def lock_in(rate: Array, threshold: float) -> Array:
    return np.where(np.abs(rate) < threshold, 0.0, np.sign(rate) * np.sqrt(np.maximum(rate**2 - threshold**2, 0.0)))


def limit(rate: Array, depth: float) -> float:
    """Where an output clips that is `depth` °/s short of the largest rate."""
    return float(np.abs(rate).max()) - depth


def clean_output(schedule: Schedule, sensor: Sensor, device: Device, faults: Faults, limited: bool = True) -> Array:
    """Outputs without noise or quantisation, shape (n, 3 or 6). limited: whether a limit cuts them."""
    delay = float(faults["time_latency"].theta[0]) if "time_latency" in faults else 0.0
    felt = stimulus(schedule, faults, delay)
    rate = _gyro(felt, device, faults, schedule.index)
    if "gyro_bandwidth" in faults:
        nodes, weights = np.polynomial.laguerre.laggauss(LAG_NODES)
        lag = float(faults["gyro_bandwidth"].theta[0])
        rate = np.zeros_like(rate)
        for node, weight in zip(nodes, weights, strict=True):
            past = stimulus(schedule, faults, delay + lag * float(node))
            rate += weight * _gyro(past, device, faults, schedule.index)
    if "gyro_axis_delay" in faults:
        for axis, late in enumerate(faults["gyro_axis_delay"].theta):
            past = stimulus(schedule, faults, delay + float(late))
            rate[:, axis] = _gyro(past, device, faults, schedule.index)[:, axis]
    if "samples_dropped" in faults:
        ((moment,), (lost,)) = faults["samples_dropped"].shape, faults["samples_dropped"].theta
        later = _gyro(stimulus(schedule, faults, delay - float(lost)), device, faults, schedule.index)
        rate = np.where((schedule.time >= moment)[:, None], later, rate)
    if "gyro_vibration_rectification" in faults:
        rate = rate + faults["gyro_vibration_rectification"].theta * _shaken(schedule, felt.table_rate)[:, None]
    if "gyro_bias_temperature_lagged" in faults:
        (lag,) = faults["gyro_bias_temperature_lagged"].shape
        rate = rate + faults["gyro_bias_temperature_lagged"].theta * behind(schedule, lag)[:, None]
    if "gyro_angular_acceleration" in faults:
        later, earlier = (
            stimulus(schedule, faults, delay + step).rate for step in (-ACCELERATION_STEP, ACCELERATION_STEP)
        )
        rate = rate + faults["gyro_angular_acceleration"].theta * (later - earlier) / (2 * ACCELERATION_STEP)
    if "gyro_fold_over" in faults:
        span = 2 * float(faults["gyro_fold_over"].theta[0])
        rate = rate - span * np.round(rate / span)
    if "gyro_dead_zone" in faults:
        rate = lock_in(rate, float(faults["gyro_dead_zone"].theta[0]))
    if limited:
        rate = clipped(faults, rate, rate)
    if "gyro_soft_saturation" in faults:
        swing = 2 * float(faults["gyro_soft_saturation"].theta[0]) * rate
        rate = np.where(
            swing == 0.0, rate, rate * 2 * np.expm1(swing) / ((np.exp(swing) + 1) * np.where(swing, swing, 1))
        )
    if sensor.accel is None:
        return rate
    force = _accel(felt, device, faults, schedule.site.gravity)
    if "accel_vibration_rectification" in faults:
        later, earlier = (
            stimulus(schedule, faults, step).table_rate for step in (-ACCELERATION_STEP, ACCELERATION_STEP)
        )
        jerks = np.radians(later - earlier) / (2 * ACCELERATION_STEP)
        force = force + faults["accel_vibration_rectification"].theta * _shaken(schedule, jerks)[:, None]
    return np.hstack([rate, force])


def _shaken(schedule: Schedule, vector: Array) -> Array:
    """Mean square of what a vector (n, 3) does about its mean in each segment that rocks, per sample; 0 in others."""
    found = np.zeros(len(vector))
    for number, segment in enumerate(schedule.segments):
        if segment.kind == "rock":
            here = schedule.index == number
            found[here] = np.mean(np.sum((vector[here] - vector[here].mean(axis=0)) ** 2, axis=1))
    return found


def noise_factor(faults: Faults) -> float:
    """By how much the gyro's white standard deviation is larger than without the fault."""
    fault = faults.get("gyro_noise_excess")
    return 1.0 if fault is None else 1.0 + float(fault.theta[0])


def accel_noise_factor(faults: Faults) -> float:
    """The same of the accelerometers."""
    fault = faults.get("accel_noise_excess")
    return 1.0 if fault is None else 1.0 + float(fault.theta[0])


def recorded(sensor: Sensor, free: Array, faults: Faults, noise: Array) -> Array:
    """Outputs as recorded: noise added, clipped where the device clips, rounded to the resolution. free: outputs that no limit cuts."""
    values = clipped(faults, free, free + noise)
    steps = np.array(sensor.counts) if sensor.counts else np.repeat([t.resolution for t in sensor.triads], 3)
    for channel, step in steps_of(faults).items():
        steps[channel] = step
    return np.round(values / steps) * steps


def clipped(faults: Faults, free: Array, values: Array) -> Array:
    """Outputs with or without noise, cut at the limit of a device that saturates. free: outputs without noise that no limit cuts; their
    largest rate determines the limit."""
    values = values.copy()
    if "gyro_saturation" in faults:
        stop = limit(free[:, :3], float(faults["gyro_saturation"].theta[0]))
        values[:, :3] = np.clip(values[:, :3], -stop, stop)
    if "gyro_saturation_asymmetric" in faults:
        (side,), (depth,) = faults["gyro_saturation_asymmetric"].shape, faults["gyro_saturation_asymmetric"].theta
        stop = float((side * free[:, :3]).max()) - float(depth)
        values[:, :3] = side * np.minimum(side * values[:, :3], stop)
    return values


def steps_of(faults: Faults) -> dict[int, float]:
    """The coarse counts of faults, by channel."""
    first = {"gyro_quantization": 0, "accel_quantization": 3}
    return {
        channel: float(faults[name].theta[0])
        for name, start in first.items()
        if name in faults
        for channel in range(start, start + 3)
    }


def coarse(faults: Faults, values: Array) -> Array:
    """Outputs rounded to the coarse counts of faults alone."""
    values = values.copy()
    for channel, step in steps_of(faults).items():
        values[:, channel] = np.round(values[:, channel] / step) * step
    return values


def stuck(time: Array, values: Array, faults: Faults) -> Array:
    """The output, whose samples are those of earlier rows for a time."""
    if "samples_stuck" not in faults:
        return values
    (begin,), (lasting,) = faults["samples_stuck"].shape, faults["samples_stuck"].theta
    row = np.arange(len(time))
    fresh = (time < begin) | (time >= begin + lasting)
    return values[np.maximum.accumulate(np.where(fresh, row, 0))]


def fault(effect: str, *theta: float, shape: tuple[float, ...] = ()) -> dict[str, Fault]:
    """One fault, as the functions here take them."""
    return {effect: Fault(effect, np.array(theta, float), shape)}
