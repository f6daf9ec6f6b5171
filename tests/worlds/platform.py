"""A gimballed platform on a three-ring rocking table: attitude of its element, its accelerometers, gimbals and rings, integrated here.

The inertial frame is that of the site, east, north and up, when the element is released. Columns of a matrix are a body's axes in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.worlds.felt import EARTH, GRAVITY, LATITUDE, STANDARD_GRAVITY, Felt, Step, turn

Array = NDArray[np.float64]

ARCSEC = np.radians(1) / 3600
PER_HOUR = np.radians(1) / 3600
AMPLITUDE, FREQUENCY, PHASES = 3.0, 0.2, (0.0, 45.0, 90.0)  # deg, Hz, deg
ROCKED = 480.0  # s from the beginning of the record
SETTLE, FADE = 5.0, 1 / FREQUENCY  # s
RINGS = {"north up east": (90.0, 0.0, 90.0), "up south east": (90.0, 0.0, 180.0)}
"""deg, of the rings about north, east and up, outermost first: they bring the base's x, y and z from east, north and up there."""
FIRST, SECOND = 61.0, 599.0  # s: middles of the windows
_WEIGHT = 1e-6 * STANDARD_GRAVITY
_EARTH = np.radians(EARTH) / 3600 * np.array([0.0, np.cos(np.radians(LATITUDE)), np.sin(np.radians(LATITUDE))])


@dataclass(frozen=True)
class Sizes:
    """Standard deviations of what is drawn for each release. drift: deg/h; walk: deg/√h, of the attitude; caging: arcmin, about each axis;
    bias_walk: µg/√h; ring: arcsec, of the reading of a ring after it has come to rest."""

    drift: float = 0.002
    walk: float = 0.0004
    caging: float = 1.0
    bias_walk: float = 10.0
    ring: float = 15.0


class Platform:
    """g and deg: accelerometers along x, y and z of the element, gimbals and rings, outermost first.

    The element drifts at a constant rate, and faster while the base rocks. installation: nominal angles [arcsec] of the accelerometers,
    xz, xy, yz, yx, zy, zx, each wrong by 2 arcsec.
    """

    def __init__(
        self,
        draw: np.random.Generator,
        steps: Sequence[Step],
        installation: Sequence[float],
        sizes: Sizes | None = None,
    ) -> None:
        self.steps, self.sizes, self.draw = steps, sizes or Sizes(), draw
        self.constant = 0.3 * draw.standard_normal(3) * PER_HOUR
        rocking = 0.012 * draw.standard_normal(3)  # deg/h
        self.rocking = rocking * PER_HOUR
        self.bias = 50 * draw.standard_normal(3) * _WEIGHT
        self.inputs = _input_axes((np.array(installation) + 2 * draw.standard_normal(6)) * ARCSEC)
        share = (ROCKED - FIRST) / (SECOND - FIRST)
        self.truth: Mapping[str, float] = {
            f"{kind}drift_{axis}": share * value
            for axis, value in zip("xyz", rocking, strict=True)
            for kind in ("", "gimbal_")
        }

    def outputs(self, felt: Felt) -> Array:
        out = np.zeros((len(felt.time), 9))
        for length in {step.dwell for step in self.steps if step.mode == "navigation"}:
            chosen = [n for n, step in enumerate(self.steps) if step.mode == "navigation" and step.dwell == length]
            rows = np.array([np.flatnonzero(felt.step == n) for n in chosen])  # (runs, n)
            seconds = felt.time[rows[0]] - felt.time[rows[0][0]]
            out[rows] = self._runs([self.steps[n] for n in chosen], seconds)
        return out

    def _runs(self, steps: Sequence[Step], seconds: Array) -> Array:
        """(runs, n, 9) at some seconds since the record began."""
        size, draw, shape = self.sizes, self.draw, (len(steps), len(seconds), 3)
        interval = float(seconds[1] - seconds[0])
        per_step = np.sqrt(interval / 3600)  # √h
        rocks = np.array([step.rocks for step in steps])[:, None]
        rocking = (rocks & (seconds < ROCKED))[..., None]  # (runs, n, 1)
        lead = np.where(rocks, SETTLE + FADE, SETTLE)  # s from the release to the record, (runs, 1)
        drift = self.constant + size.drift * PER_HOUR * draw.standard_normal((len(steps), 3))
        walk = np.radians(size.walk) * per_step * draw.standard_normal(shape)
        turned = _turns(interval * (drift[:, None] + rocking * self.rocking) + walk)
        caged = _turns(60 * ARCSEC * size.caging * draw.standard_normal((len(steps), 3)))
        element = np.empty((*shape, 3))
        now = np.array([step.matrix.T for step in steps]) @ caged @ _turns(lead * drift)
        for k in range(len(seconds)):
            element[:, k], now = now, now @ turned[:, k]
        earth = _turns(_EARTH * (lead + seconds)[..., None])
        shaking = (
            np.sin(2 * np.pi * FREQUENCY * seconds + 0.3)[:, None] * 0.004 * draw.standard_normal((len(steps), 1, 3))
        )
        force = (earth @ (rocking * shaking + [0.0, 0.0, GRAVITY])[..., None]).swapaxes(2, 3) @ element
        bias = self.bias + np.cumsum(size.bias_walk * _WEIGHT * per_step * draw.standard_normal(shape), axis=1)
        readings = (force[:, :, 0] @ self.inputs.T + bias) / STANDARD_GRAVITY
        rings = np.array([_ring_angles(step, seconds) for step in steps])
        base = (
            earth
            @ _turns(rings[..., :1] * [0.0, 1, 0])
            @ _turns(rings[..., 1:2] * [1.0, 0, 0])
            @ _turns(rings[..., 2:] * [0.0, 0, 1])
        )
        a = base.swapaxes(2, 3) @ element
        gimbals = [
            np.arctan2(-a[..., 1, 2], a[..., 2, 2]),
            np.arcsin(a[..., 0, 2]),
            np.arctan2(-a[..., 0, 1], a[..., 0, 0]),
        ]
        before, after = size.ring * ARCSEC * draw.standard_normal((2, len(steps), 1, 3))
        shown = rings - np.where((rocks & (seconds > ROCKED + FADE))[..., None], after, before)
        return np.concatenate([readings, np.degrees(np.stack(gimbals, axis=2)), np.degrees(shown)], axis=2)


def _ring_angles(step: Step, seconds: Array) -> Array:
    """(n, 3), rad."""
    at = np.radians(RINGS[step.axes])
    if not step.rocks:
        return np.tile(at, (len(seconds), 1))
    fading = np.clip((ROCKED + FADE - seconds) / FADE, 0.0, 1.0)
    phase = 2 * np.pi * FREQUENCY * seconds[:, None] + np.radians(PHASES)
    return np.asarray(at + np.radians(AMPLITUDE) * fading[:, None] * np.sin(phase))


def _input_axes(angles: Array) -> Array:
    """(3, 3): rows are the accelerometers' input axes in the element's, each turned about one axis and then about the other."""
    xz, xy, yz, yx, zy, zx = angles
    x, y, z = np.eye(3)
    return np.array([turn(xy * y) @ turn(xz * z) @ x, turn(yx * x) @ turn(yz * z) @ y, turn(zx * x) @ turn(zy * y) @ z])


def _turns(vectors: Array) -> Array:
    """Matrices (…, 3, 3) of rotations about vectors (…, 3) by their lengths, rad (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=float), -1, 0)
    none = np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(*x.shape, 3, 3)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + np.sinc(angle / 2 / np.pi) ** 2 / 2 * (cross @ cross)
    )
