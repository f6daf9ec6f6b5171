"""Computes the effect of a sensor error on navigation if a rotation cycle modulates this error. The harmonics of the cycle drive
the Schuler loop.

Velocity v and attitude error ψ are written as complex numbers (east + i·north). A gyro error ε(t) and an accelerometer error b(t)
in the navigation frame obey v′ = −i·g·ψ + b and ψ′ = ε − i·v/R (Titterton and Weston, Strapdown Inertial Navigation Technology, 2nd
ed., 12.3); therefore v″ + ω_s²·v = −i·g·ε + b′ with ω_s² = g/R, where g is gravity and R is the radius of the Earth. The Earth's
rotation turns the plane of the free oscillation at the rate Ω·sin φ, as in Foucault's pendulum.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.physics.earth import Site
from planrunner.physics.rotation_cycle import RotationCycle

MEAN_RADIUS = 6_371_009.0  # m, of the Earth (IUGG)


def schuler_rate(site: Site) -> float:
    """Returns the Schuler rate ω_s [rad/s]; its period is 84.4 min."""
    return math.sqrt(site.gravity / (MEAN_RADIUS + site.height))


def schuler_drive(cycle: RotationCycle, seconds: float, site: Site) -> float:
    """Returns the factor by which a rotation cycle increases the free Schuler oscillation that a constant gyro drift causes. The
    factor is the largest amplitude within `seconds`, divided by the amplitude that the same drift causes without rotation. The
    result is 0 if the cycle is so short that none of its harmonics lies near the Schuler rate.

    A drift ε(t) leaves an oscillation of the size |∫ ε·exp(−iωt) dt| at each of the two free rates ω. The sum of these two sizes is
    the semi-major axis of the ellipse along which the velocity moves. Without rotation, this axis is 2·|ε|/ω_s. Over n cycles, the
    integral is the integral over one cycle times |sin(nx)/sin(x)|, where x = ω·period/2. Near a harmonic, this factor grows with
    every cycle.
    """
    natural = schuler_rate(site)
    if round(natural * cycle.period / (2 * math.pi)) == 0:
        return 0.0
    turning = site.earth_rate * math.sin(site.latitude)
    counts = np.arange(1, max(1, int(seconds / cycle.period + 1e-9)) + 1)
    sizes = np.zeros(len(counts))
    for rate in (natural - turning, -natural - turning):
        half = math.remainder(rate * cycle.period, 2 * math.pi) / 2
        growth = np.abs(np.sin(counts * half) / math.sin(half)) if half else counts
        sizes += abs(sum(cycle.integral(rate))) * growth
    return float(sizes.max()) * natural / 2


def forced_velocity(
    cycle: RotationCycle, gyro: complex, accelerometer: complex, site: Site, harmonic: int
) -> tuple[complex, complex]:
    """Computes the two velocity errors [m/s], as east + i·north, that a harmonic of the cycle forces: one at plus and one at minus
    `harmonic` times the frequency of the cycle.

    `gyro` [rad/s], `accelerometer` [m/s^2]: constant sensor errors, given for the orientation at the first position. A harmonic of
    exp(iθ) with the coefficient c and the rate ω causes the velocity c·(−i·g·gyro + i·ω·accelerometer)/(ω_s² − ω²). Harmonic 0 is
    the mean velocity, which the residual of the cycle causes.
    """
    natural = schuler_rate(site)
    forced = []
    for sign in (1, -1):
        rate = sign * harmonic * 2 * math.pi / cycle.period
        share = sum(cycle.integral(rate)) / cycle.period
        drive = -1j * site.gravity * gyro + 1j * rate * accelerometer
        forced.append(complex(share * drive / (natural**2 - rate**2)))
    return forced[0], forced[1]
