"""Computes the input of a sensor that is moved without commands. The recorded channels that show the motion determine this input.

The sensor is moved by hand, by a vehicle, or by a jig without a drive. An encoder, an attitude reference, or other gyros and
accelerometers on the same body measure the motion. Derivatives are computed from differences between neighbouring samples. The mean
of a derivative over a stretch therefore depends only on the ends of the stretch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.earth import Site


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """Contains the input of a moving sensor at n samples, along the sensor's axes.

    `attitude`: array of shape (n, 3, 3), transforms vectors from site axes to the sensor's axes; zeros if the recording does not
    show the attitude. `turn`: array of shape (n, 3), rotation rate of the sensor, rad/s, relative to the Earth if the attitude is
    known. `swing`: array of shape (n, 3), angular acceleration, rad/s². `omega`: array of shape (n, 3), rotation rate relative to
    inertial space, rad/s. `force`: array of shape (n, 3), specific force, m/s²; zeros if the recording does not show it.
    """

    attitude: Array
    turn: Array
    swing: Array
    omega: Array
    force: Array

    def averaged(self, size: int) -> BodyMotion:
        """Returns the motion averaged over every `size` consecutive samples."""
        return BodyMotion(*(averaged(part, size) for part in self._parts))

    def at(self, rows: NDArray[np.bool_]) -> BodyMotion:
        """Returns the motion at the selected samples. `rows`: array of shape (n,), True for these samples."""
        return BodyMotion(*(part[rows] for part in self._parts))

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self.attitude, self.turn, self.swing, self.omega, self.force


def averaged(values: Array, size: int) -> Array:
    """Averages every `size` consecutive values (n, …). Returns an array of shape (n // size, …). If the last group is incomplete,
    it is left out."""
    whole = len(values) - len(values) % size
    return np.asarray(values[:whole].reshape(-1, size, *values.shape[1:]).mean(axis=1))


def by_attitude(time: Array, quaternions: Array, site: Site, force: Array | None = None) -> BodyMotion:
    """Computes the motion from unit quaternions (n, 4), real part first. The quaternions transform vectors from the sensor's axes
    to East-North-Up. `force`: array of shape (n, 3), measured specific force; by default, the specific force of a sensor that only
    rotates. `time`: array of shape (n,), s."""
    from scipy.spatial.transform import Rotation

    attitude = Rotation.from_quat(quaternions, scalar_first=True).as_matrix().swapaxes(1, 2)
    turn = rates_of(time, attitude)
    omega = turn + attitude @ site.earth_rate_enu
    felt = attitude @ site.specific_force_enu if force is None else force
    return BodyMotion(attitude, turn, slope(time, turn), omega, felt)


def by_rates(time: Array, omega: Array, start: Array | None, site: Site, force: Array | None = None) -> BodyMotion:
    """Computes the motion from measured angular rates (n, 3) relative to inertial space. `start`: array of shape (3, 3), attitude
    at the first sample, or None if it is unknown. `force`: array of shape (n, 3), measured specific force; by default, the specific
    force of a sensor that only rotates. If the attitude is unknown and `force` is not given, the specific force is zero. `time`:
    array of shape (n,), s. `omega`: array of shape (n, 3), these rates, rad/s."""
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
    """Returns a motion of which only the measured specific force (n, 3) is known. All other quantities are zero."""
    n = len(force)
    return BodyMotion(np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), force)


def followed(time: Array, omega: Array, start: Array, site: Site) -> Array:
    """Computes the attitudes of a body that starts at the attitude `start` and rotates at the rate `omega` in its own axes. The
    rate [rad/s] has the shape (n, 3), the attitudes have the shape (n, 3, 3). `time`: array of shape (n,), s.

    Between two samples, the body rotates at the mean of the two rates. The attitude relative to inertial space is the product of
    these rotations. The rotation of the site at the Earth's rate is taken into account. All partial products are computed in about
    log₂ n steps; each step doubles the number of rotations in a product.
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
    """Computes the angular rates in the body's axes from the two neighbours of each sample. Returns an array of shape (n, 3).
    `attitude`: array of shape (n, 3, 3), transforms vectors to the body's axes. `time`: array of shape (n,), s."""
    from scipy.spatial.transform import Rotation

    before, after = np.r_[0, np.arange(len(time) - 1)], np.r_[np.arange(1, len(time)), len(time) - 1]
    turned = Rotation.from_matrix(attitude[before] @ attitude[after].swapaxes(1, 2)).as_rotvec()
    return np.asarray(turned / (time[after] - time[before])[:, None])


def slope(time: Array, values: Array) -> Array:
    """Computes the time derivative of values (n, …) from the neighbours of each sample (`numpy.gradient`). The result has the shape
    of the values."""
    return np.asarray(np.gradient(values, time, axis=0))
