"""Simulates the stabilised element of a virtual platform. The element is caged to the base, then released and fixed in inertial
space except for its drift.

In axes of the element, the drift angle has four parts: a constant rate, a rate that rocking causes, a random walk, and a transient
after caging. The transient occurs during the first minute, when the element leaves the dead zone of the levelling loops. Rocking
causes drift by rectification. The servos transmit a fraction of the base's motion about every axis. Two such motions with a phase
difference cause a steady rate, which is proportional to the square of the motion (coning; Savage, Strapdown Analytics, 2000, 10.1).
In the model, this rate is proportional to the square of the base's angular rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json, JsonObject
from planrunner.instruments.virtual.base_motion import base_axes, mean_square_rate, turn, turn_by
from planrunner.instruments.virtual.world import World

CATCH_UP = 100.0  # Hz, with which the time between two recordings is followed


@dataclass(frozen=True, slots=True)
class DriftLaw:
    """Contains the coefficients that determine the drift of the stabilised element.

    `constant`: constant drift rate, rad/s. `rectified`: drift rate divided by the square of the base's angular rate, s.
    `random_walk`: coefficient of the random walk, rad/√s. `leaving`: time constant with which the element leaves the dead zone of
    the levelling loops after its release, s.
    """

    constant: Array
    rectified: Array
    random_walk: float
    leaving: float


@dataclass(frozen=True, slots=True)
class Element:
    """The state of the element since it was last caged or released.

    `caged`: rotation vector (3,) [rad] from the base to the element while caged, in axes of the base. `released`: time of release,
    s; None while caged. `axes`: array of shape (3, 3), axes of the element at its release, as rows in East-North-Up. `left`: array
    of shape (3,) in rad, rotation vector that the element approaches exponentially while it leaves the dead zone (see
    `DriftLaw.leaving`). `drifted`: array of shape (3,) in rad, drift angle at the time `at` [s].
    """

    caged: Array
    released: float | None = None
    axes: Array | None = None
    left: Array | None = None
    drifted: Array | None = None
    at: float = 0.0

    def release(self, world: World, left: Array) -> Element:
        """Releases the element, which is then fixed in inertial space except for its drift. `left`: rotation vector (3,) of the
        turn with which the element leaves the dead zone, rad."""
        if self.released is not None:
            return self
        now = world.now()
        axes = self._held(base_axes(world, np.array([now])))[0]
        return Element(self.caged, now, axes, left, np.zeros(3), now)

    def _held(self, base: Array) -> Array:
        """Returns the axes (n, 3, 3) of the caged element: the axes of the base (n, 3, 3), rotated by `caged`."""
        return np.stack([turn_by(base[:, :, k], -self.caged) for k in range(3)], axis=2)

    def advance(self, world: World, time: float, law: DriftLaw, draw: np.random.Generator) -> Element:
        """Returns the state of the element at a later time [s], at which a recording begins."""
        walk = draw.standard_normal(3)
        if self.released is None or self.drifted is None or time <= self.at:
            return self
        count = max(1, round((time - self.at) * CATCH_UP))
        step = (time - self.at) / count
        middles = np.asarray(self.at + step * (np.arange(count) + 0.5), dtype=np.float64)
        square = float(np.sum(mean_square_rate(world, middles))) * step
        drifted = self.drifted + law.constant * (time - self.at) + law.rectified * square
        return replace(self, drifted=drifted + law.random_walk * np.sqrt(time - self.at) * walk, at=time)

    def follow(
        self, world: World, times: Array, step: float, base: Array, law: DriftLaw, draw: np.random.Generator
    ) -> tuple[Array, Element]:
        """Returns the axes of the element at `times` as rows in East-North-Up, shape (n, 3, 3), and the state of the element after
        these times. The first of `times` must be the time of this state (the attribute `at`); the times are `step` s apart.

        `base`: array of shape (n, 3, 3), axes of the base at the same times.
        """
        if self.released is None or self.axes is None or self.left is None or self.drifted is None:
            return self._held(base), self
        rates = law.constant + law.rectified * mean_square_rate(world, times)[:, None]
        steps = rates * step + law.random_walk * np.sqrt(step) * draw.standard_normal((times.size, 3))
        grown = self.drifted + np.cumsum(steps, axis=0)
        since = times - self.released
        leaving = -np.expm1(-since / law.leaving)[:, None] * self.left
        angle = np.vstack([self.drifted, grown[:-1]]) + leaving
        earth = world.site.earth_rate_enu
        size = float(np.linalg.norm(earth))
        columns = []
        for site_axis in np.eye(3):
            # The site turns with the Earth, so that a site axis turns forwards as seen from inertial space.
            carried = turn(np.broadcast_to(site_axis, (times.size, 3)), earth / size, size * since)
            columns.append(turn_by(carried @ self.axes.T, -angle))
        return np.stack(columns, axis=2), replace(self, drifted=grown[-1], at=float(times[-1]) + step)

    def to_json(self) -> JsonObject:
        arrays = {name: getattr(self, name) for name in ("caged", "axes", "left", "drifted")}
        plain = {name: None if value is None else value.tolist() for name, value in arrays.items()}
        return {**plain, "released": self.released, "at": self.at}

    @classmethod
    def from_json(cls, state: Mapping[str, Json]) -> Element:
        arrays = {name: None if (value := state[name]) is None else np.array(value, float) for name in _ARRAYS}
        caged = arrays.pop("caged")
        assert caged is not None
        return cls(caged, state["released"], at=float(state["at"]), **arrays)


_ARRAYS = ("caged", "axes", "left", "drifted")
