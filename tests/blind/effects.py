"""The effects that the generator draws from: natural magnitudes, shapes, and where each can be seen at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.blind.device import Sensor
from tests.blind.motion import Array, Fault, Schedule

Shape = tuple[float, ...]
Draw = Callable[[Schedule, np.random.Generator], Shape]


@dataclass(frozen=True)
class Kind:
    """How an effect is drawn: natural magnitude of each parameter; `linear` in them; `signed` or not.

    `shapes` are the values of the shape parameters that an oracle tries, `draw` gives a case its own.
    `covariance` effects change the noise, not the mean. `needs` names what a plan or sensor must have.
    """

    name: str
    scale: tuple[float, ...]
    linear: bool = True
    signed: bool = True
    covariance: bool = False
    shapes: tuple[Shape, ...] = ((),)
    draw: Draw | None = None
    needs: str = ""
    largest: float = 1000.0  # amplitude, in natural magnitudes, beyond which the effect would not be physical

    def magnitudes(self, schedule: Schedule) -> Array:
        """Natural magnitudes; the error of placing has three angles for each orientation of the plan."""
        repeat = len(schedule.places) if self.name == "table_position_error" else 1
        return np.tile(self.scale, repeat)

    def fault(self, direction: Array, amplitude: float, shape: Shape) -> Fault:
        return Fault(self.name, amplitude * direction, shape)


def _seed(_: Schedule, rng: np.random.Generator) -> Shape:
    return (float(rng.integers(1, 2**31)),)


def _one_or_two(_: Schedule, rng: np.random.Generator) -> Shape:
    return (float(rng.integers(1, 3)),)


def _warm_up_time(_: Schedule, rng: np.random.Generator) -> Shape:
    return (float(np.exp(rng.uniform(np.log(200), np.log(2500)))),)


def _moment(schedule: Schedule, rng: np.random.Generator) -> Shape:
    return (float(rng.uniform(schedule.time[0], schedule.time[-1])),)


def _rocked_moment(schedule: Schedule, rng: np.random.Generator) -> Shape:
    """In the middle half of the rocking segments."""
    rocks = [s for s in schedule.segments if s.kind == "rock"]
    return (float(rng.uniform(rocks[len(rocks) // 4].start, rocks[3 * len(rocks) // 4].start)),)


def _within_a_segment(schedule: Schedule, rng: np.random.Generator) -> Shape:
    """In the first half of a segment."""
    segment = schedule.segments[int(rng.integers(len(schedule.segments)))]
    return (float(segment.start + rng.uniform(0.1, 0.5) * segment.duration),)


def _line(_: Schedule, rng: np.random.Generator) -> Shape:
    """Supply of 50 or 60 Hz, or one of its first harmonics, slightly off; and a phase."""
    true = float(rng.choice([50.0, 60.0]) * rng.integers(1, 4)) * (1 + float(rng.uniform(-0.01, 0.01)))
    return true, float(rng.uniform(0, 2 * np.pi))


def _side(_: Schedule, rng: np.random.Generator) -> Shape:
    return (float(rng.choice([-1.0, 1.0])),)


def _lag(_: Schedule, rng: np.random.Generator) -> Shape:
    return (float(np.exp(rng.uniform(np.log(60), np.log(900)))),)


def _tone(_: Schedule, rng: np.random.Generator) -> Shape:
    return float(rng.uniform(0.7, 9.0)), float(rng.uniform(0, 2 * np.pi))


def _sawtooth(schedule: Schedule, rng: np.random.Generator) -> Shape:
    return (float((schedule.time[-1] - schedule.time[0]) / rng.uniform(4, 30)),)


def _slow(schedule: Schedule, rng: np.random.Generator) -> Shape:
    return float((schedule.time[-1] - schedule.time[0]) / rng.uniform(2, 8)), float(rng.uniform(0, 2 * np.pi))


def _resonant_rate(schedule: Schedule, rng: np.random.Generator) -> Shape:
    rates = sorted({abs(s.rate) for s in schedule.segments if s.rate})
    return (float(rng.choice(rates) * rng.uniform(0.9, 1.1)),)


ONE = (1.0,)
CATALOGUE = {
    kind.name: kind
    for kind in (
        Kind("gyro_bias_temperature", (1e-3,) * 3 + (1e-5,) * 3),
        Kind("gyro_scale_temperature", (1e-4,) * 3),
        Kind("gyro_scale_nonlinearity", (1e-9,) * 3),
        Kind("gyro_scale_asymmetry", (1e-4,) * 3),
        Kind("gyro_g_sensitivity", (1e-2,) * 9),
        Kind("gyro_g2_sensitivity", (1e-2,) * 18),
        Kind("gyro_bandwidth", (1e-3,), linear=False, signed=False, needs="rock", largest=20),
        Kind("gyro_dead_zone", (1e-2,), linear=False, signed=False, largest=50),
        Kind("gyro_saturation", ONE, linear=False, signed=False, largest=100),
        Kind("gyro_bias_random_walk", (1e-4,) * 3, draw=_seed),
        Kind(
            "gyro_warm_up",
            (0.02,) * 3,
            shapes=tuple((t,) for t in (200, 330, 550, 910, 1500, 2500)),
            draw=_warm_up_time,
        ),
        Kind("gyro_thermal_hysteresis", (5e-3,) * 3),
        Kind("gyro_thermal_gradient", (0.05,) * 3),
        Kind("gyro_noise_excess", ONE, linear=False, signed=False, covariance=True, largest=30),
        Kind("gyro_quantization", ONE, linear=False, signed=False, covariance=True),
        Kind("magnetic_sensitivity", (1e-2,) * 9),
        Kind("accel_bias_temperature", (1e-3,) * 3, needs="accel"),
        Kind("accel_scale_temperature", (1e-4,) * 3, needs="accel"),
        Kind("accel_second_order", (1e-2,) * 3, needs="accel"),
        Kind("table_tilt", (1e-3,) * 2, largest=100),
        Kind("table_azimuth", (1e-2,), largest=50),
        Kind("table_position_error", (1e-3,) * 3, largest=50),
        Kind("table_rate_ripple", (1e-3,) * 2, shapes=((1.0,), (2.0,)), draw=_one_or_two, largest=100),
        Kind("table_wobble", (1e-3,) * 2, largest=100),
        Kind("table_rate_error", (1e-3,)),
        Kind("site_latitude", (1e-2,), largest=30),
        Kind("lever_arm", (0.02,) * 3, needs="accel", largest=50),
        Kind("time_latency", (1e-3,), linear=False, signed=False, needs="rock", largest=40),
    )
}
FOREIGN = {
    kind.name: kind
    for kind in (
        Kind("vibration_tone", (1e-3,) * 3, draw=_tone),
        Kind("sawtooth_bias", (1e-3,) * 3, draw=_sawtooth),
        Kind("rate_resonance", (1e-2,) * 3, draw=_resonant_rate),
        Kind("ripple_three_per_turn", (1e-3,) * 2, draw=lambda _schedule, _rng: (3.0,), largest=100),
        Kind("temperature_rate_times_rate", (1e-2,) * 3, needs="turning_ramp"),
        Kind("emi_bursts", (1e-2,) * 3, draw=_seed),
        Kind("slow_sine_bias", (1e-3,) * 3, draw=_slow),
        Kind("backlash", (1e-3,), linear=False, signed=False, needs="rock", largest=30),
        Kind("vibration_rectification", (1e-4,) * 3, needs="accel"),
        Kind("segment_offsets", (1e-3,) * 3, draw=_seed),
        Kind("magnetic_times_temperature", (1e-4,) * 3),
    )
}
FURTHER = {
    kind.name: kind
    for kind in (
        Kind("gyro_bias_step", (1e-3,) * 3, draw=_moment),
        Kind("accel_bias_step", (1e-3,) * 3, draw=_moment, needs="accel"),
        Kind("gyro_vibration_rectification", (1e-5,) * 3, needs="rock"),
        Kind("accel_vibration_rectification", (1e-4,) * 3, needs="rocked_accel"),
        Kind("gyro_axis_delay", (1e-3,) * 3, linear=False, needs="rock", largest=40),
        Kind("gyro_bias_temperature_lagged", (1e-3,) * 3, draw=_lag, needs="ramp"),
        Kind("gyro_saturation_asymmetric", ONE, linear=False, signed=False, draw=_side, largest=100),
        Kind("gyro_soft_saturation", (1e-6,), linear=False, signed=False, largest=1e4),
        Kind("accel_noise_excess", ONE, linear=False, signed=False, covariance=True, needs="accel"),
        Kind("accel_quantization", ONE, linear=False, signed=False, covariance=True, needs="accel"),
        Kind("samples_dropped", (1e-3,), linear=False, signed=False, draw=_rocked_moment, needs="rock", largest=40),
        Kind("mount_shift", (1e-3,) * 3, draw=_moment, largest=50),
        Kind("samples_stuck", ONE, linear=False, signed=False, draw=_within_a_segment),
        Kind("gyro_line_interference", (1e-3,) * 3, draw=_line),
        Kind("accel_line_interference", (1e-3,) * 3, draw=_line, needs="accel"),
    )
}
"""Effects of the catalogue that the campaign does not draw, so that a seed keeps its cases; see `confusion`."""
KINDS = {**CATALOGUE, **FOREIGN, **FURTHER}


def applies(kind: Kind, schedule: Schedule, sensor: Sensor) -> bool:
    """Whether the sensor and the plan have what the effect acts on."""
    match kind.needs:
        case "accel":
            return sensor.accel is not None
        case "rocked_accel":
            return sensor.accel is not None and any(s.kind == "rock" for s in schedule.segments)
        case "ramp":
            return any(s.ramp for s in schedule.segments)
        case "rock":
            return any(s.kind == "rock" for s in schedule.segments)
        case "turning_ramp":
            return any(s.ramp and s.kind == "rate" for s in schedule.segments)
    return True


# Factors under which an effect shows, in the words of the answers' "where": the top-ranked place must name one of them. Temperature and
# time go together, since every plan here visits its temperatures one after the other.
SHOWS_UNDER: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(
        ("gyro_bias_temperature", "accel_bias_temperature", "gyro_thermal_hysteresis", "magnetic_times_temperature"),
        ("temperature", "time"),
    ),
    **dict.fromkeys(("gyro_scale_temperature", "temperature_rate_times_rate"), ("temperature", "time", "rate")),
    "accel_scale_temperature": ("temperature", "time", "orientation"),
    "gyro_thermal_gradient": ("temperature", "time", "band"),
    **dict.fromkeys(
        ("gyro_scale_nonlinearity", "gyro_scale_asymmetry", "gyro_saturation", "rate_resonance"),
        ("rate",),
    ),
    "gyro_dead_zone": ("rate", "orientation", "table angle"),  # the Earth's rate is below it or above as the axis lies
    "lever_arm": ("rate", "table angle"),  # while rocking the tangential acceleration follows the angle
    "vibration_rectification": ("rate",),
    **dict.fromkeys(
        ("gyro_g_sensitivity", "gyro_g2_sensitivity", "accel_second_order", "table_position_error"), ("orientation",)
    ),
    **dict.fromkeys(
        ("magnetic_sensitivity", "table_tilt", "table_azimuth", "site_latitude"), ("orientation", "table angle", "rate")
    ),
    **dict.fromkeys(("table_rate_ripple", "table_wobble", "ripple_three_per_turn"), ("table angle", "rate")),
    **dict.fromkeys(("gyro_bandwidth", "time_latency", "backlash"), ("rate", "band", "table angle")),
    **dict.fromkeys(
        ("gyro_bias_random_walk", "gyro_warm_up", "slow_sine_bias", "sawtooth_bias", "segment_offsets"),
        ("time", "band"),
    ),
    **dict.fromkeys(("gyro_noise_excess", "gyro_quantization", "vibration_tone"), ("channel", "band")),
    "emi_bursts": ("time", "band", "channel"),
    "table_rate_error": (),
}
