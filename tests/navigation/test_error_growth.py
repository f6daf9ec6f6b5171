"""How constant errors grow over a day: the mechanisation against textbook solutions and against a linear model written apart.

The apart model is the North-East-Down φ-angle form with nine inputs as in Groves, "Principles of GNSS, Inertial, and Multisensor
Integrated Navigation Systems", 2nd ed., section 14.2.4, solved by SciPy's matrix exponential. Errors are small enough (some km) that
what the linear theory leaves out, relatively of the order of error/R ≈ 10⁻³, stays below the tolerances.
"""

from __future__ import annotations

import numpy as np
import pytest
from increments import DEG_H, EARTH_RATE, MICRO_G, _radii, at_rest, navigator, stand, turn
from scipy.linalg import expm

from planrunner.navigation.error_equations import ErrorEquations, exponential
from planrunner.navigation.wgs84 import normal_gravity
from planrunner.physics.earth import Site

Array = np.ndarray

LATITUDE = np.radians(40.0)
GRAVITY = float(normal_gravity(LATITUDE))
NORTH, EAST = _radii(LATITUDE)
SCHULER = np.sqrt(GRAVITY / NORTH)
DAY = 86400.0
DT = 0.5  # at rest all increments are the same; a longer interval only makes the run shorter


def run(
    gyro: tuple[float, ...] = (0, 0, 0),
    accelerometer: tuple[float, ...] = (0, 0, 0),
    rate: float = EARTH_RATE,
    heading: float = 0.0,
    seconds: float = DAY,
):
    """Errors of a level unit whose axes are east, north and up. rate: of the Earth, rad/s; heading: error of it, deg."""
    rotation = np.eye(3)
    sample = at_rest(LATITUDE, GRAVITY, rotation, DT, gyro, accelerometer, rate)
    start = turn("z", -heading) @ rotation
    unit = navigator(LATITUDE, start, every=round(60 / DT), earth_rate=rate)
    return stand(unit, sample, DT, seconds)


def within(found: Array, wanted: Array, share: float) -> None:
    assert np.abs(found - wanted).max() < share * np.abs(wanted).max()


# -- without the Earth's rotation: single Schuler loops in closed form -------------------------------------------------


def test_accelerometer_error_makes_a_schuler_oscillation() -> None:
    """δN = ∇/ω²·(1 − cos ωt), a north velocity of ∇/ω·sin ωt (Titterton and Weston, table 12.1)."""
    bias = 100 * MICRO_G
    time, found = run(accelerometer=(0, bias, 0), rate=0.0, seconds=6 * 3600)
    within(found[1], bias / SCHULER**2 * (1 - np.cos(SCHULER * time)), 2e-3)
    within(found[3], bias / SCHULER * np.sin(SCHULER * time), 2e-3)


def test_east_gyro_drift_makes_a_ramp_with_oscillation() -> None:
    """δN = −ε·R·(t − sin(ωt)/ω): 0.01 deg/h is 0.6 nautical miles an hour."""
    drift = 0.01 * DEG_H
    time, found = run(gyro=(drift, 0, 0), rate=0.0, seconds=6 * 3600)
    within(found[1], -drift * NORTH * (time - np.sin(SCHULER * time) / SCHULER), 2e-3)
    assert found[1, -1] / 1852 / 6 == pytest.approx(-0.6, rel=0.07)


def test_initial_tilt_makes_an_oscillation_about_nothing() -> None:
    """φ_N0: δv_E = −φ·g/ω·sin ωt = −φ·√(gR)·sin ωt; a unit that is held tilted in the computed attitude."""
    tilt = np.degrees(1e-5)
    sample = at_rest(LATITUDE, GRAVITY, np.eye(3), DT, rate=0.0)
    unit = navigator(LATITUDE, turn("y", -tilt), every=round(60 / DT), earth_rate=0.0)
    time, found = stand(unit, sample, DT, 6 * 3600)
    natural = np.sqrt(GRAVITY / EAST)
    within(found[2], -1e-5 * np.sqrt(GRAVITY * EAST) * np.sin(natural * time), 5e-3)


# -- with it: 24-hour oscillations -------------------------------------------------------------------------------------


def terrestrial(gyro: Array, heading: float, time: Array) -> tuple[Array, Array]:
    """East and north error [m] by the ψ angle, which an observer among the stars sees: ψ̇ = −Ω×ψ − ε has the solution below, with a
    part along the Earth's axis that grows evenly and one across it that turns once a day. Levels stay true on average, so latitude
    follows ψ_E and longitude −ψ_N/cos L; the start of the drift leaves a Schuler oscillation ε/ω·sin ωt, which the Earth turns as it
    turns Foucault's pendulum (Britting, "Inertial Navigation Systems Analysis", chapters 5 and 7). Terms of the order (Ω/ω)² = 0.4 % are
    left out."""
    axis = np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    s, c = np.sin(EARTH_RATE * time)[:, None], np.cos(EARTH_RATE * time)[:, None]

    def across(vector: Array) -> tuple[Array, Array]:
        along = (vector @ axis) * axis
        return along, vector - along

    along, rest = across(gyro)
    psi = -(along * time[:, None] + rest * s / EARTH_RATE - np.cross(axis, rest) * (1 - c) / EARTH_RATE)
    along, rest = across(np.array([0.0, 0.0, heading]))
    psi = psi + along + rest * c - np.cross(axis, rest) * s
    # Initial rate of the levels, as a number east + i·north; it swings as a pendulum whose plane turns by −Ω·sin L.
    levels = -(gyro[0] + 1j * gyro[1]) - heading * EARTH_RATE * np.cos(LATITUDE)
    swing = levels * np.sin(SCHULER * time) / SCHULER * np.exp(-1j * EARTH_RATE * np.sin(LATITUDE) * time)
    north = NORTH * (psi[:, 0] - swing.real)
    east = -EAST * (psi[:, 1] - swing.imag)
    return east, north


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["east", "north", "azimuth"])
def test_gyro_drift_over_a_day_against_the_textbook(axis: int) -> None:
    drift = np.zeros(3)
    drift[axis] = 0.01 * DEG_H
    time, found = run(gyro=tuple(drift))
    east, north = terrestrial(drift, 0.0, time)
    scale = 0.02 * np.hypot(east, north).max()
    assert np.abs(found[0] - east).max() < scale
    assert np.abs(found[1] - north).max() < scale


def test_heading_error_over_a_day_against_the_textbook() -> None:
    """The computed attitude is turned clockwise by 1 arcmin: C_computed = (1 − φ×)·C with φ_U = +1 arcmin."""
    time, found = run(heading=1 / 60)
    east, north = terrestrial(np.zeros(3), np.radians(1 / 60), time)
    scale = 0.02 * np.hypot(east, north).max()
    assert np.abs(found[0] - east).max() < scale
    assert np.abs(found[1] - north).max() < scale


# -- the linear model written apart ------------------------------------------------------------------------------------


def north_east_down() -> tuple[Array, Array]:
    """States δL, δλ [rad], δv_N, δv_E [m/s], ψ_N, ψ_E, ψ_D [rad], C_computed = (1 + ψ×)·C; inputs gyro N, E, D, accelerometer N, E."""
    wn, wd = EARTH_RATE * np.cos(LATITUDE), -EARTH_RATE * np.sin(LATITUDE)
    f = np.zeros((7, 7))
    f[0, 2], f[1, 3] = 1 / NORTH, 1 / EAST / np.cos(LATITUDE)
    f[2, 3], f[3, 2] = 2 * wd, -2 * wd
    f[2, 5], f[3, 4] = -GRAVITY, GRAVITY  # δψ × f with a specific force of −g down
    f[4, 5], f[5, 4], f[5, 6], f[6, 5] = wd, -wd, wn, -wn  # −ω_in × δψ
    f[4, 0], f[6, 0] = EARTH_RATE * np.sin(LATITUDE), EARTH_RATE * np.cos(LATITUDE)  # −δω_in
    f[4, 3], f[5, 2], f[6, 3] = -1 / EAST, 1 / NORTH, np.tan(LATITUDE) / EAST
    b = np.zeros((7, 5))
    b[4, 0] = b[5, 1] = b[6, 2] = 1.0
    b[2, 3] = b[3, 4] = 1.0
    return f, b


@pytest.mark.parametrize(
    ("gyro", "accelerometer"),
    [
        ((0.01, 0, 0), (0, 0, 0)),
        ((0, 0.01, 0), (0, 0, 0)),
        ((0, 0, 0.01), (0, 0, 0)),
        ((0, 0, 0), (50, 0, 0)),
        ((0, 0, 0), (0, 50, 0)),
        ((0.003, -0.006, 0.004), (-20, 35, 0)),
    ],
)
def test_a_day_against_the_matrix_exponential(gyro: tuple[float, ...], accelerometer: tuple[float, ...]) -> None:
    """Gyro errors in deg/h and accelerometer errors in µg, east, north, up."""
    drift, bias = np.array(gyro) * DEG_H, np.array(accelerometer) * MICRO_G
    time, found = run(gyro=tuple(drift), accelerometer=tuple(bias))
    f, b = north_east_down()
    inputs = np.array([drift[1], drift[0], -drift[2], bias[1], bias[0]])
    both = np.zeros((8, 8))
    both[:7, :7], both[:7, 7] = f, b @ inputs
    step, state, wanted = expm(both * 60.0), np.array([0.0] * 7 + [1.0]), []
    for _ in time:
        state = step @ state
        wanted.append([state[1] * EAST * np.cos(LATITUDE), state[0] * NORTH, state[3], state[2]])
    expected = np.array(wanted).T
    scale = np.hypot(*expected[:2]).max()
    assert np.abs(found[:2] - expected[:2]).max() < 5e-3 * scale
    assert np.abs(found[2:] - expected[2:]).max() < 5e-3 * np.abs(expected[2:]).max()


def test_our_error_equations_are_those_written_apart() -> None:
    site = Site(LATITUDE, GRAVITY, earth_rate=EARTH_RATE)
    equations = ErrorEquations.at(site)
    f, b = north_east_down()
    # Ours: δE, δN, δv_E, δv_N, φ_E, φ_N, φ_U with C_computed = (1 − φ×)·C; there (1 + ψ×).
    to_ned = np.zeros((7, 7))
    to_ned[0, 1], to_ned[1, 0] = 1 / NORTH, 1 / EAST / np.cos(LATITUDE)
    to_ned[2, 3] = to_ned[3, 2] = 1.0
    to_ned[4, 5] = to_ned[5, 4] = -1.0
    to_ned[6, 6] = 1.0
    assert np.allclose(to_ned @ equations.dynamics @ np.linalg.inv(to_ned), f, rtol=1e-9, atol=1e-18)
    inputs = np.zeros((6, 5))
    inputs[1, 0] = inputs[0, 1] = 1.0
    inputs[2, 2] = -1.0
    inputs[4, 3] = inputs[3, 4] = 1.0
    assert np.allclose(to_ned @ equations.inputs @ inputs, b, rtol=1e-12)


def test_exponential_noise_and_levels() -> None:
    site = Site(LATITUDE, GRAVITY, earth_rate=EARTH_RATE)
    equations = ErrorEquations.at(site)
    assert np.allclose(exponential(equations.dynamics * 600), expm(equations.dynamics * 600), rtol=1e-9, atol=1e-9)
    # Random walk of a gyro about north after a minute: ∫ of white noise, as in table 12.1: var φ = N²·t, var v = g²·N²·t³/3.
    density = np.zeros((6, 6))
    density[1, 1] = 4.0
    noise = equations.noise(density, 60.0)
    assert noise[5, 5] == pytest.approx(4 * 60, rel=2e-3)
    assert noise[2, 2] == pytest.approx(4 * GRAVITY**2 * 60**3 / 3, rel=2e-3)
    # Where levels and azimuth have come to rest nothing moves any more: the known limits of alignment.
    levels = equations.levelled()
    error = np.array([0.01 * DEG_H, 0, 0, 0, 0, 0])
    assert levels[2] @ error == pytest.approx(-0.01 * DEG_H / (EARTH_RATE * np.cos(LATITUDE)))
    bias = np.array([0, 0, 0, 0, 100 * MICRO_G, 0])
    assert levels[0] @ bias == pytest.approx(-100 * MICRO_G / GRAVITY)
    moving = equations.dynamics[[2, 3, 4]][:, 4:] @ levels + equations.inputs[[2, 3, 4]]
    assert np.allclose(moving[:2, 3:5], 0, atol=1e-12)
    assert np.allclose(moving[2, [0, 3]], 0, atol=1e-18)
