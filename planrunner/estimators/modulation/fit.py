"""Separates two parts of a navigation's velocity error: the part that repeats with the rotation cycle, and the Schuler and 24-hour
oscillations.

The horizontal velocity is written as a complex number, east + i·north. A least-squares fit over a whole number of cycles describes
the velocity by three parts: a straight line, the free oscillations at ±ω_s − Ω·sin φ and ±Ω, and the harmonics of the cycle at
positive and negative rates.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.earth import Site
from planrunner.physics.modulation import schuler_rate

Complex = NDArray[np.complex128]

FEWEST_CYCLES = 4
_APART = 1.5  # oscillations over the record by which two rates must differ to be separated
_BESIDE = (1.5, 2.5, 3.5, 4.5)  # oscillations over the record from a harmonic, at which only noise remains


class TooLittleError(ValueError):
    """Raised if the record does not determine the periodic part. The message gives the reason."""


@dataclass(frozen=True, slots=True)
class PeriodicPart:
    """Describes the part of a velocity error that repeats with the rotation cycle.

    `orders`: array of shape (m,), orders of the harmonics, positive and negative. `velocities`: array of shape (m,), coefficients
    of the harmonics [m/s]. `noise`: array of shape (m,), standard uncertainty of each coefficient [m/s], from the residuals.
    `hidden`: orders of the harmonics that cannot be fitted, because their frequency is too close to a free oscillation. `period`:
    period of the cycle, s.
    """

    orders: NDArray[np.int_]
    velocities: Complex
    noise: Array
    hidden: tuple[int, ...]
    period: float

    def largest_velocity(self) -> float:
        return largest(self.orders, self.velocities)

    def largest_position(self) -> float:
        """Returns the amplitude [m] of the position error that repeats with the cycle."""
        return largest(self.orders, self.velocities * self.period / (2j * math.pi * self.orders))

    def position_noise(self) -> float:
        """Returns an upper bound [m] of the standard uncertainty of `largest_position`, for the case that the peaks of all
        harmonics coincide."""
        return float(np.hypot.reduce(self.noise * self.period / (2 * math.pi * np.abs(self.orders))))


def largest(orders: NDArray[np.int_], parts: Complex) -> float:
    """Returns the largest absolute value of Σ parts·exp(i·order·ω·t) during a cycle."""
    if not len(orders):
        return 0.0
    phase = np.linspace(0, 2 * math.pi, 64 * int(np.abs(orders).max()), endpoint=False)
    return float(np.abs(np.exp(1j * np.outer(phase, orders)) @ parts).max())


def periodic_part(time: Array, velocity: Complex, period: float, highest: int, site: Site) -> PeriodicPart:
    """Separates the part of a velocity error that repeats with the rotation cycle.

    `time`: array of shape (n,) in s, evenly spaced, starting when a cycle starts. `velocity`: array of shape (n,) in m/s. `period`:
    period of the cycle, s. `highest`: the highest harmonic to fit.

    Raises `TooLittleError` if the record does not determine this part.
    """
    step = float(time[1] - time[0]) if len(time) > 1 else math.inf
    if len(time) > 1 and np.ptp(np.diff(time)) > 1e-3 * step:
        raise TooLittleError("its points are not evenly spaced")
    cycles = int((float(time[-1]) + step - float(time[0])) / period) if len(time) > 1 else 0
    if cycles < FEWEST_CYCLES:
        raise TooLittleError(
            f"the navigation contains {cycles} whole cycles of {period:.0f} s, but at least {FEWEST_CYCLES} are needed"
        )
    within = time - time[0] < cycles * period
    time, velocity = time[within] - time[0], velocity[within]
    lasting = len(time) * step
    highest = min(highest, int(period / (4 * step)))
    free = free_rates(site)
    rates = {order: 2 * math.pi * order / period for order in range(-highest, highest + 1) if order}
    near = 2 * math.pi * _APART / lasting
    hidden = {order for order, rate in rates.items() if min(abs(rate - other) for other in free) < near}
    orders = np.array([order for order in rates if order not in hidden], dtype=int)
    if not len(orders):
        raise TooLittleError(f"its points are {step:.0f} s apart, too far for a cycle of {period:.0f} s")
    columns = [np.ones_like(time), time / lasting, *(np.exp(1j * rate * time) for rate in free)]
    slow = len(columns)
    columns += [np.exp(1j * rates[order] * time) for order in orders]
    columns += [np.exp(1j * rates[order] * time) for order in hidden]
    matrix = np.stack(columns, axis=1)
    found: Complex = np.linalg.lstsq(matrix, velocity, rcond=None)[0].astype(np.complex128)
    rest = velocity - matrix @ found
    beside = [
        np.mean([abs(np.mean(rest * np.exp(-1j * (rates[order] + sign * 2 * math.pi * apart / lasting) * time))) ** 2
                 for apart in _BESIDE for sign in (1, -1)])
        for order in orders
    ]  # fmt: skip
    return PeriodicPart(
        orders,
        found[slow : slow + len(orders)],
        np.sqrt(beside),
        tuple(sorted({abs(order) for order in hidden})),
        period,
    )


def free_rates(site: Site) -> tuple[float, float, float, float]:
    """Returns the rates [rad/s] at which a navigator's error oscillates freely: the Schuler oscillation, split by the Earth's
    rotation, and the 24-hour oscillation."""
    natural, turning = schuler_rate(site), site.earth_rate * math.sin(site.latitude)
    return natural - turning, -natural - turning, site.earth_rate, -site.earth_rate
