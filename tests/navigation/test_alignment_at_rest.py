"""Alignment: coarse against the attitude that was made, fine against noise it is given, and against the known limits."""

from __future__ import annotations

import numpy as np
import pytest
from increments import DEG_H, EARTH_RATE, MICRO_G, at_rest, turn

from planrunner.navigation import attitude
from planrunner.navigation.alignment import FineAlignment, coarse
from planrunner.navigation.error_equations import TILT, ErrorEquations
from planrunner.navigation.mechanisation import Navigator
from planrunner.physics.earth import Site

Array = np.ndarray

SITE = Site(np.radians(45.0), 9.806, earth_rate=EARTH_RATE)
EQUATIONS = ErrorEquations.at(SITE)
NOISE = np.array([np.radians(0.003) / 60] * 3 + [3e-5] * 3)  # rad/√s and m/s/√s


def tilt_between(found: Array, true: Array) -> Array:
    """φ of C_found = (1 − φ×)·C_true."""
    turned = found @ true.T
    return -np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2


def aligned(increments: Array, dt: float, start: Array, noise: Array = NOISE, constant: Array | None = None):
    unit = Navigator(
        attitude.quaternion(start), np.zeros(3), (SITE.latitude, 0.0, 0.0), earth_rate=EARTH_RATE, every=round(1 / dt)
    )
    knots = unit.advance(increments, np.full(increments.shape[1], dt))
    fine = FineAlignment(EQUATIONS, np.diag(noise**2), 1.0, constant)
    turned = attitude.matrix(knots.attitude)
    before = np.concatenate([start[None], turned[:-1]])
    fine.take(knots.velocity[:, :2], (turned + before) / 2, attitude.turned_about_up(before, turned))
    return fine.finish(unit.rotation)


@pytest.mark.parametrize("degrees", [0.0, 77.0, 250.0])
def test_coarse_attitude_is_exact_without_errors(degrees: float) -> None:
    rotation = turn("z", degrees) @ turn("x", 10) @ turn("y", -15)
    sample = at_rest(SITE.latitude, SITE.gravity, rotation, 1.0)
    assert np.allclose(coarse(sample[:3], sample[3:]), rotation, atol=1e-14)


def test_constant_errors_leave_the_known_limits() -> None:
    """Heading ε_E/(Ω·cos L) and tilts ∇/g (Titterton and Weston, section 10.2), both by averaging and by the filter."""
    rotation, dt = np.eye(3), 0.1
    drift, bias = 0.02 * DEG_H, 80 * MICRO_G
    sample = at_rest(SITE.latitude, SITE.gravity, rotation, dt, gyro=(drift, 0, 0), accelerometer=(0, bias, 0))
    start = turn("z", 0.3) @ coarse(sample[:3], sample[3:])
    found = aligned(np.repeat(sample[:, None], 9000, axis=1), dt, start)
    tilt = tilt_between(found.rotation, rotation)
    assert tilt[0] == pytest.approx(-bias / SITE.gravity, rel=1e-2)
    assert tilt[2] == pytest.approx(-drift / (EARTH_RATE * np.cos(SITE.latitude)), rel=1e-2)
    assert np.degrees(tilt[2]) * 60 == pytest.approx(-6.5, abs=0.1)  # arcmin; 0.02/15.04/cos 45° rad


def test_noise_is_identified_by_the_covariance() -> None:
    """Tilt and azimuth over the standard uncertainties stated: 3 × 60 numbers of mean square one (χ², 99.9 %)."""
    draw, dt, n = np.random.default_rng(11), 0.1, 3000
    rotation = turn("z", 40) @ turn("x", 2)
    sample = at_rest(SITE.latitude, SITE.gravity, rotation, dt)
    squares = []
    for _ in range(60):
        noisy = sample[:, None] + NOISE[:, None] * np.sqrt(dt) * draw.standard_normal((6, n))
        found = aligned(noisy, dt, coarse(noisy[:3].mean(axis=1), noisy[3:].mean(axis=1)))
        tilt = tilt_between(found.rotation, rotation)
        squares.append(tilt @ np.linalg.solve(found.covariance[TILT, TILT], tilt))
    from scipy.stats import chi2

    low, high = chi2.ppf([5e-4, 1 - 5e-4], 180)
    # The measurement is taken for a little less still than it is, so that the covariance may only be too wide by that.
    assert 0.7 * low < sum(squares) < high
    assert np.sqrt(found.covariance[6, 6]) == pytest.approx(
        NOISE[0] / np.sqrt(n * dt) / (EARTH_RATE * np.cos(SITE.latitude)), rel=0.15
    )


def test_swaying_does_no_harm() -> None:
    """0.3 deg of roll with a period of 4 s, which the gyros follow: the mean attitude is off, the aligned one at the end is not."""
    dt, n = 0.01, 30_000
    angle = np.radians(0.3) * np.sin(2 * np.pi * dt * np.arange(n + 1) / 4.3)
    earth = EARTH_RATE * np.array([0.0, np.cos(SITE.latitude), np.sin(SITE.latitude)])
    middle = (angle[1:] + angle[:-1]) / 2
    s, c = np.sin(middle), np.cos(middle)
    # C(t) = R_y(angle); body rate about y, and Earth rate and gravity seen from the body.
    rate = np.array([c * earth[0] - s * earth[2], np.full(n, earth[1]), s * earth[0] + c * earth[2]])
    increments = np.vstack([rate * dt, SITE.gravity * np.array([-s, np.zeros(n), c]) * dt])
    increments[1] += np.diff(angle)
    found = aligned(increments, dt, turn("z", 0.5))
    tilt = tilt_between(found.rotation, turn("y", np.degrees(angle[-1])))
    assert np.abs(np.degrees(tilt)).max() < 1e-3


@pytest.mark.parametrize("misalignment", [0.0, 8e-5])
def test_turning_from_stop_to_stop_separates_constant_errors_from_heading(misalignment: float) -> None:
    """Half turns every 100 s: the heading error that a constant east drift leaves falls from 6.5 arcmin to below 1, and the horizontal
    constant errors are found."""
    dt, drift, bias = 0.05, 0.02 * DEG_H, 80 * MICRO_G
    pieces = []
    for k in range(8):
        here = turn("z", 180.0 * (k % 2))
        sample = at_rest(SITE.latitude, SITE.gravity, here, dt, (drift, 0, 0), (0, bias, 0))
        pieces.append(np.repeat(sample[:, None], 2000, axis=1))
        back = 1 if k % 2 else -1
        angles = np.radians(180 * (k % 2) - back * (np.arange(360) + 0.5) / 2)
        turning = np.array(
            [
                at_rest(SITE.latitude, SITE.gravity, turn("z", a), dt, (drift, 0, 0), (0, bias, 0))
                for a in np.degrees(angles)
            ]
        ).T
        turning[2] -= back * np.radians(0.5)
        turning[0] -= back * np.radians(0.5) * misalignment
        pieces.append(turning)
    constant = np.array([0.1 * DEG_H] * 3 + [1e-2] * 3)
    found = aligned(np.hstack(pieces), dt, turn("z", 0.1), constant=constant)
    tilt = tilt_between(found.rotation, np.eye(3))
    assert abs(np.degrees(tilt[2])) * 60 < 1
    assert found.constant[0] == pytest.approx(drift, rel=0.05)
    assert abs(found.constant[4] - bias) < 3 * np.sqrt(found.covariance[11, 11])
    assert np.all(np.abs(tilt) < 3 * np.sqrt(np.diag(found.covariance[TILT, TILT])))
