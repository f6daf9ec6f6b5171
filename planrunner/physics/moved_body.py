"""The input of a sensor whose motion was not commanded, computed from the channels of the recording that show the motion.

A hand, a vehicle or a jig without a drive moves the sensor. An encoder, an attitude reference, or other gyros and accelerometers on
the same body show the motion. Derivatives are differences over the neighbouring samples, so that the mean of a derivative over a
stretch depends only on the ends of the stretch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.earth import Site


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """The input of a moving sensor at n samples, along the sensor's axes.

    attitude: (n, 3, 3), transforms site vectors to the sensor's axes; zeros if the recording does not show it. turn: (n, 3), rad/s,
    rotation rate of the sensor, relative to the Earth if the attitude is known; swing: (n, 3), rad/s², angular acceleration. omega: (n,
    3), rad/s, rotation rate relative to inertial space. force: (n, 3), m/s², specific force; zeros if the recording does not show it.
    """

    attitude: Array
    turn: Array
    swing: Array
    omega: Array
    force: Array

    def averaged(self, size: int) -> BodyMotion:
        """Means over `size` consecutive samples."""
        return BodyMotion(*(averaged(part, size) for part in self._parts))

    def at(self, rows: NDArray[np.bool_]) -> BodyMotion:
        """The motion at some of the samples."""
        return BodyMotion(*(part[rows] for part in self._parts))

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self.attitude, self.turn, self.swing, self.omega, self.force


def averaged(values: Array, size: int) -> Array:
    """Means (n // size, …) over `size` consecutive values (n, …). An incomplete last group is omitted."""
    whole = len(values) - len(values) % size
    return np.asarray(values[:whole].reshape(-1, size, *values.shape[1:]).mean(axis=1))


def by_attitude(time: Array, quaternions: Array, site: Site, force: Array | None = None) -> BodyMotion:
    """The motion from unit quaternions (n, 4), real part first, that transform vectors from the sensor's axes to East-North-Up.
    force: (n, 3), measured specific force; by default, the specific force of a sensor that only rotates."""
    from scipy.spatial.transform import Rotation

    attitude = Rotation.from_quat(quaternions, scalar_first=True).as_matrix().swapaxes(1, 2)
    turn = rates_of(time, attitude)
    omega = turn + attitude @ site.earth_rate_enu
    felt = attitude @ site.specific_force_enu if force is None else force
    return BodyMotion(attitude, turn, slope(time, turn), omega, felt)


def by_rates(time: Array, omega: Array, start: Array | None, site: Site, force: Array | None = None) -> BodyMotion:
    """The motion from measured angular rates (n, 3) relative to inertial space. start: (3, 3), the attitude at the first sample;
    None if it is unknown. If the attitude is unknown, only the measured specific force `force` (n, 3) is used."""
    n = len(time)
    if start is None:
        nothing = np.zeros((n, 3))
        return BodyMotion(
            np.zeros((n, 3, 3)), omega, slope(time, omega), omega, nothing if force is None else np.asarray(force)
        )
    attitude = followed(time, omega, start, site)
    turn = omega - attitude @ site.earth_rate_enu
    felt = attitude @ site.specific_force_enu if force is None else force
    return BodyMotion(attitude, turn, slope(time, turn), omega, felt)


def by_force(force: Array) -> BodyMotion:
    """The motion from measured specific force (n, 3) alone."""
    n = len(force)
    return BodyMotion(np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), force)


def followed(time: Array, omega: Array, start: Array, site: Site) -> Array:
    """Attitudes (n, 3, 3) of a body that rotates with omega (n, 3) in its axes, beginning with `start`.

    Between two samples the body rotates by the mean of both rates. The attitude relative to inertial space is the product of these
    rotations. The site turns with the Earth's rate meanwhile. All partial products are computed in about log₂ n steps, each of which
    doubles the number of rotations in a product.
    """
    from scipy.spatial.transform import Rotation

    step = np.diff(time)[:, None]
    turns = Rotation.from_rotvec(-(omega[1:] + omega[:-1]) / 2 * step).as_matrix()
    whole = np.concatenate([np.eye(3)[None], turns])
    reach = 1
    while reach < len(whole):
        whole[reach:] = whole[reach:] @ whole[:-reach].copy()
        reach *= 2
    site_turns = Rotation.from_rotvec((time - time[0])[:, None] * site.earth_rate_enu).as_matrix()
    return np.asarray(whole @ start @ site_turns)


def rates_of(time: Array, attitude: Array) -> Array:
    """Angular rates (n, 3) in the body's axes, as differences between the two neighbours of each sample, from attitudes (n, 3, 3)
    that transform vectors to these axes."""
    from scipy.spatial.transform import Rotation

    before, after = np.r_[0, np.arange(len(time) - 1)], np.r_[np.arange(1, len(time)), len(time) - 1]
    turned = Rotation.from_matrix(attitude[before] @ attitude[after].swapaxes(1, 2)).as_rotvec()
    return np.asarray(turned / (time[after] - time[before])[:, None])


def slope(time: Array, values: Array) -> Array:
    """Time derivative, (n, …), of values (n, …), from the neighbours of each sample (`numpy.gradient`)."""
    return np.asarray(np.gradient(values, time, axis=0))
