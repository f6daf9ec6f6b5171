"""Outputs of an IMU at rest and while turning, from scalar products in site axes; nothing from the package's physics.

Without noise, recordings consist of means; a turn's mean is taken over 3600 directions of the table instead of in closed form. With noise,
they consist of samples, from which planrunner makes its own statistics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from recorded import from_means, from_samples

from planrunner.archive.recording import RecordedSegment
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Cycle, Rest, Segment, Spin
from tests.directions import WORDS

LATITUDE, GRAVITY = math.radians(39.98), 9.80154
SITE = Site(LATITUDE, GRAVITY)
EARTH = math.radians(15.041067) / 3600
GYROS, ACCELS = ("gx", "gy", "gz"), ("ax", "ay", "az")
DEG_H, MG, MRAD = math.radians(1) / 3600, 9.80665e-3, 1e-3

SAMPLES = 480
"""Of a segment: 15 in each of the 32 batches of which planrunner takes means."""
_ANGLES = np.arange(3600) * 2 * math.pi / 3600
_ZERO, _ONE = np.zeros(3600), np.ones(3600)
TURN = np.array(
    [[np.cos(_ANGLES), np.sin(_ANGLES), _ZERO], [-np.sin(_ANGLES), np.cos(_ANGLES), _ZERO], [_ZERO, _ZERO, _ONE]]
).transpose(2, 0, 1)  # what a table sees on its way round, of a vector in site axes

# Every axis up and down, with the other two in two directions: twelve of the 24.
POSITIONS = (
    *("east north up", "west south up", "east south down", "west north down"),
    *("up east north", "up west south", "down east south", "down west north"),
    *("north up east", "south up west", "south down east", "north down west"),
)
UPWARD = {"x": "up east north", "y": "north up east", "z": "east north up"}


def attitude(words: str) -> np.ndarray:
    return np.array([WORDS[word] for word in words.split()], dtype=float)


def rest(words: str, dwell: float = 60.0, temperature: float | None = None) -> Segment:
    return Segment(0, words.replace(" ", "-"), attitude(words), words, Rest(), dwell, temperature=temperature)


def spin(axis: str, rate: float, dwell: float = 60.0) -> Segment:
    """rate: deg/s about the vertical, along which the sensor's axis points."""
    words = UPWARD[axis]
    return Segment(0, f"{axis}{rate:+g}", attitude(words), words, Spin(math.radians(rate)), dwell)


def plan(rates: Sequence[float] = (48.0, -48.0), positions: Sequence[str] = POSITIONS) -> list[Segment]:
    """By default, the dwells of 60 s at the rates are eight whole turns."""
    return [*map(rest, positions), *(spin(axis, rate) for axis in "xyz" for rate in rates)]


def felt(segment: Segment, tilt: np.ndarray | None = None, rate_error: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Mean rate [rad/s] and specific force [m/s²] on the sensor's axes."""
    assert segment.attitude is not None
    axes = segment.attitude if tilt is None else segment.attitude @ tilt
    earth, up = EARTH * np.array([0, math.cos(LATITUDE), math.sin(LATITUDE)]), np.array([0, 0, GRAVITY])
    if isinstance(segment.motion, Rest):
        return axes @ earth, axes @ up
    assert isinstance(segment.motion, Spin | Cycle)
    rate = segment.motion.rate * (1 + rate_error)
    seen = (TURN @ earth).mean(axis=0)
    return axes @ (seen + rate * np.array([0, 0, 1.0])), axes @ up


def outputs(segment: Segment, truth: Mapping[str, np.ndarray], **errors: Any) -> tuple[np.ndarray, np.ndarray]:
    """Gyros in rad/s, accelerometers in m/s²: S·M·true + b + G·f with the arrays A_g, b_g, G, A_a, b_a of `truth`."""
    rate, force = felt(segment, **errors)
    return truth["A_g"] @ rate + truth["b_g"] + truth["G"] @ force, truth["A_a"] @ force + truth["b_a"]


def drawn_truth(draw: np.random.Generator) -> dict[str, np.ndarray]:
    """Per cent of scale factor, milliradians of misalignment, 10 deg/h and 5 mg of bias, 1 deg/h/g of g-sensitivity."""
    return {
        "A_g": np.eye(3) + 0.01 * draw.standard_normal((3, 3)) * (0.3 + 0.7 * np.eye(3)),
        "A_a": np.eye(3) + 0.01 * draw.standard_normal((3, 3)) * (0.3 + 0.7 * np.eye(3)),
        "b_g": 10 * DEG_H * draw.standard_normal(3),
        "b_a": 5 * MG * draw.standard_normal(3),
        "G": DEG_H / 9.80665 * draw.standard_normal((3, 3)),
    }


def named(truth: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The truth by the names and units that the estimator reports, by trigonometry of the rows."""
    found: dict[str, float] = {}
    for kind, matrix, bias, unit in (("gyro", "A_g", "b_g", DEG_H), ("accel", "A_a", "b_a", MG)):
        for i, a in enumerate("xyz"):
            row = truth[matrix][i]
            found[f"{kind}_bias_{a}"] = truth[bias][i] / unit
            found[f"{kind}_scale_{a}"] = math.hypot(*row)
            for j, b in enumerate("xyz"):
                if i != j:
                    found[f"{kind}_misalignment_{a}_{b}"] = math.cos(math.acos(row[j] / math.hypot(*row))) / MRAD
                if kind == "gyro":
                    found[f"gyro_g_sensitivity_K_{b}_{a}"] = truth["G"][i, j] / DEG_H * 9.80665
    return found


def sampled(
    segment: Segment, truth: Mapping[str, np.ndarray], samples: int, tilt: np.ndarray | None = None
) -> np.ndarray:
    """Outputs without noise, (6, samples), each as in the middle of its interval, on a table that turns meanwhile."""
    assert segment.attitude is not None and segment.dwell is not None
    axes = segment.attitude if tilt is None else segment.attitude @ tilt
    earth, up = EARTH * np.array([0, math.cos(LATITUDE), math.sin(LATITUDE)]), np.array([0, 0, GRAVITY])
    turned = segment.rate * segment.dwell * (np.arange(samples) + 0.5) / samples
    site = np.stack(
        [
            np.cos(turned) * earth[0] + np.sin(turned) * earth[1],
            np.cos(turned) * earth[1] - np.sin(turned) * earth[0],
            np.full(samples, earth[2] + segment.rate),
        ]
    )
    rate, force = axes @ site, (axes @ up)[:, None] + np.zeros(samples)
    gyros = truth["A_g"] @ rate + truth["b_g"][:, None] + truth["G"] @ force
    return np.vstack([gyros, truth["A_a"] @ force + truth["b_a"][:, None]])


def recorded(
    segments: Sequence[Segment],
    truth: Mapping[str, np.ndarray],
    draw: np.random.Generator | None = None,
    noise: tuple[float, float] = (0.1 * DEG_H * 60, 1e-4),
    tilt: float = 0.0,
    flicker: np.ndarray | None = None,
) -> tuple[RecordedSegment, ...]:
    """One recording in SI, with half a dwell between segments: samples with noise, or exact means without `draw`. noise: rad/√s and
    m/s²·√s, white; tilt: rad, of each orientation about each axis, the same whenever it is taken; flicker: (6, segments, batches), constant
    over a batch of samples."""
    found: list[RecordedSegment] = []
    tilts: dict[str, np.ndarray] = {}
    now = 0.0
    for place, segment in enumerate(segments):
        assert segment.dwell is not None
        if draw is None:
            means = dict(zip((*GYROS, *ACCELS), np.concatenate(outputs(segment, truth)), strict=True))
            one = from_means(segment, means, "rad/s", 1e-12, start=now)
            one.units.update(dict.fromkeys(ACCELS, "m/s^2"))
        else:
            turn = None
            if tilt:
                a, b, c = tilts.setdefault(segment.orientation, tilt * draw.standard_normal(3))
                turn = np.eye(3) + np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
            size = np.repeat(noise, 3)[:, None] / math.sqrt(segment.dwell / SAMPLES)
            values = sampled(segment, truth, SAMPLES, turn) + size * draw.standard_normal((6, SAMPLES))
            if flicker is not None:
                values += np.repeat(flicker[:, place], SAMPLES // flicker.shape[-1], axis=-1)
            time = now + segment.dwell / SAMPLES * np.arange(SAMPLES)
            channels = dict(zip((*GYROS, *ACCELS), values, strict=True))
            units = dict.fromkeys(GYROS, "rad/s") | dict.fromkeys(ACCELS, "m/s^2")
            one = from_samples(segment, time, channels, units)
        now += 1.5 * segment.dwell
        found.append(one)
    return tuple(found)
