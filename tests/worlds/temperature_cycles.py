"""Temperature cycles of a gyro at rest, in worlds where something else than the temperature changes its output.

A rising ramp and a falling one, at a constant rate, are a cycle. The bias is a straight line or a parabola over temperature.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.worlds.campaign import SITE, TABLE, Campaign
from tests.worlds.faults import Fault, Recorded, World, flicker
from tests.worlds.felt import UPWARD, Felt, Step

Array = NDArray[np.float64]

COLDEST, WARMEST, REFERENCE = -30.0, 70.0, 25.0  # degC
_RAMP = 5400.0  # s
_WHITE = 0.005  # deg/s/√Hz
_FLICKER = 24.0  # 6 deg/h, in units of the noise of the mean over a ramp


class WarmedGyro:
    """deg/s: T0 + T1·(T − 25 degC), and for every second device + T2·(T − 25 degC)²."""

    def __init__(self, draw: np.random.Generator, celsius: Callable[[Array], Array]) -> None:
        self.celsius = celsius
        self.bias, self.slope = 0.1 * draw.standard_normal(), 0.01 * draw.standard_normal()
        self.curvature = 1e-5 * draw.standard_normal() * draw.integers(2)
        self.truth: Mapping[str, float] = {"gyro_z_T0": self.bias + UPWARD / 3600, "gyro_z_T1": self.slope}

    def outputs(self, felt: Felt) -> Array:
        warm = self.celsius((felt.time - felt.time[0]) / (felt.time[-1] - felt.time[0])) - REFERENCE
        own = self.bias + self.slope * warm + self.curvature * warm**2
        return np.asarray(felt.rate[:, 2] / 3600 + own)[:, None]


def course(cycles: int) -> Callable[[Array], Array]:
    """Temperature, degC, at a share of the test."""
    return lambda share: WARMEST - (WARMEST - COLDEST) * np.abs(1 - 2 * np.mod(cycles * np.asarray(share), 1.0))


def campaign(cycles: int, keys: str = "") -> Campaign:
    """keys: of the estimate, further to channel and thermometer."""
    steps = tuple(
        Step(f"{way}{number}", "east north up", _RAMP, pause=0.0)
        for number in range(1, cycles + 1)
        for way in ("up", "down")
    )
    rows = "\n".join(
        f"  - {{label: {step.label}, orientation: {{x: east, y: north, z: up}}, dwell: {step.dwell} s}}"
        for step in steps
    )
    return Campaign(
        f"""planrunner: 1
title: temperature cycles
sensor: {{kind: gyro, outputs: [gyro_z]}}
segments:
{rows}
estimates:
  curve: {{estimator: temperature_model, channels: gyro_z, temperature_channel: sensor_temperature, bin: 2 K{keys}}}
""",
        f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, gyro]
instruments:
{TABLE}\
  gyro:
    driver: virtual_imu
    kind: gyro
    sample_rate: 1 Hz
    gyros:
      full_scale: 1000 deg/s
      angle_random_walk: {_WHITE} deg/s*sqrt(s)
      bias_instability: {{flicker[0]}} deg/s
      resolution: {{count[0]}} deg/s
      axes:
        z: {{{{}}}}
""",
        steps,
        1.0,
        {"gyro_z": "deg/s"},
        _WHITE * np.ones(1),
        "curve",
        lambda draw: WarmedGyro(draw, course(cycles)),
    )


def _place(made: Recorded) -> Array:
    """Of the temperature between the coldest, −1, and the warmest, +1."""
    assert made.celsius is not None
    return np.asarray((2 * made.celsius - COLDEST - WARMEST) / (WARMEST - COLDEST))


def _flickering(made: Recorded, draw: np.random.Generator) -> Array:
    return made.values + flicker(made, draw, _FLICKER)


def _lens(made: Recorded, draw: np.random.Generator) -> Array:
    """Rising and falling temperature differ by 0.02 deg/s, from soon after each turning point on: a lens with steep ends."""
    place, sense = _place(made), 1 - 2 * (made.step % 2)
    width = (1 - np.exp(-(1 + place) / 0.2)) * (1 - np.exp(-(1 - place) / 0.2))
    return np.asarray(made.values + (0.01 * sense * width)[:, None])


def _irreproducible(made: Recorded, draw: np.random.Generator) -> Array:
    """Every ramp has an offset and a slope that no other has, of 0.002 deg/s and 0.001 deg/s over 29 K."""
    ramps = made.step.max() + 1
    offsets, slopes = 0.002 * draw.standard_normal(ramps), 0.001 * draw.standard_normal(ramps)
    away = 50 * _place(made) / 29
    return np.asarray(made.values + (offsets[made.step] + slopes[made.step] * away)[:, None])


def _and(one: Fault, other: Fault) -> Fault:
    return lambda made, draw: other(replace(made, values=one(made, draw)), draw)


def cycle_worlds(cycles: int) -> Mapping[str, World]:
    """For a campaign of so many cycles."""
    warm = course(cycles)
    return {
        "white noise": World(celsius=warm),
        "flicker, declared": World(_flickering, flicker=_FLICKER, celsius=warm),
        "flicker, not declared": World(_flickering, celsius=warm, warns=True),
        "hysteresis": World(_lens, celsius=warm),
        "hysteresis and flicker, declared": World(_and(_lens, _flickering), flicker=_FLICKER, celsius=warm),
        "ramps that differ": World(_irreproducible, celsius=warm, warns=cycles == 1),
        "ramps that differ and flicker, declared": World(
            _and(_irreproducible, _flickering), flicker=_FLICKER, celsius=warm, warns=cycles == 1
        ),
    }
