"""Computes the strapdown mechanisation sample by sample. Numba compiles the code.

The body axes are x, y, z; the navigation axes are East-North-Up on WGS-84. One step takes the increments of angle and velocity over
the interval that ends at a sample (Savage, "Strapdown Inertial Navigation Integration Algorithm Design", J. Guidance, Control, and
Dynamics 21, 1998; Titterton and Weston, "Strapdown Inertial Navigation Technology", 2nd ed., chapters 3 and 11):

    rotation vector   φ  = Δθ + Δθ₋×Δθ/12                                  (coning, from this and the last increment)
    velocity, body    Δv = Δu + Δθ×Δu/2 + Δθ×(Δθ×Δu)/6 + (Δθ₋×Δu + Δu₋×Δθ)/12   (rotation and sculling)
    velocity          v  ← v + (1 − ω_in·dt/2 ×)·C·Δv + [γ − (2ω_ie + ω_en)×v_mid]·dt
    attitude          q  ← q(−ω_in·dt) ∘ q ∘ q(φ)
    position          trapezoid of v, with radii and latitude of the middle of the interval

Earth rate and transport rate are evaluated at the middle of the interval, so the error of a step is of third order in dt. Only the
state vector passes from one sample to the next, so the result does not depend on the division of the samples into blocks.

All computations use scalars, because handling small arrays would take longer than the arithmetic itself. The compiler inlines the
functions into one loop.
"""

from __future__ import annotations

import math

from planrunner.base.compiled import compiled
from planrunner.navigation.wgs84 import (
    ECCENTRICITY_SQUARED,
    FLATTENING,
    GRAVITY_AT_EQUATOR,
    ROTATION_RATIO,
    SEMI_MAJOR_AXIS,
    SOMIGLIANA,
)

# Indices into the state vector.
ATTITUDE, VELOCITY, LATITUDE, LONGITUDE, HEIGHT, LOOP, LAST_ANGLE, LAST_VELOCITY, STEPS = 0, 4, 7, 8, 9, 10, 11, 14, 17
STATE = 18
KNOT = 10  # numbers kept at a knot: attitude, velocity, latitude, longitude, height

_SEMI_LATUS_RECTUM = SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY_SQUARED)
_SIXTH, _TWELFTH = 1.0 / 6.0, 1.0 / 12.0  # a division costs as much as ten products
_SMALL = 0.01  # rad²; below, the series of the half-angle functions are exact to rounding


@compiled()
def _body_increments(t, u, a, b):  # type: ignore[no-untyped-def]
    """Returns the rotation vector and the velocity increment of an interval, in body axes. `t`, `u`: angle and velocity increments
    of this interval. `a`, `b`: angle and velocity increments of the preceding interval."""
    tx, ty, tz = t
    ux, uy, uz = u
    ax, ay, az = a
    bx, by, bz = b
    rotation = (
        tx + (ay * tz - az * ty) * _TWELFTH,
        ty + (az * tx - ax * tz) * _TWELFTH,
        tz + (ax * ty - ay * tx) * _TWELFTH,
    )
    rx, ry, rz = ty * uz - tz * uy, tz * ux - tx * uz, tx * uy - ty * ux
    velocity = (
        ux + 0.5 * rx + (ty * rz - tz * ry) * _SIXTH + (ay * uz - az * uy + by * tz - bz * ty) * _TWELFTH,
        uy + 0.5 * ry + (tz * rx - tx * rz) * _SIXTH + (az * ux - ax * uz + bz * tx - bx * tz) * _TWELFTH,
        uz + 0.5 * rz + (tx * ry - ty * rx) * _SIXTH + (ax * uy - ay * ux + bx * ty - by * tx) * _TWELFTH,
    )
    return rotation, velocity


@compiled()
def _turned(q, v):  # type: ignore[no-untyped-def]
    """Rotates a vector from body axes to navigation axes."""
    w, x, y, z = q
    dx, dy, dz = v
    cx, cy, cz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
    return (
        dx + 2.0 * (w * cx + y * cz - z * cy),
        dy + 2.0 * (w * cy + z * cx - x * cz),
        dz + 2.0 * (w * cz + x * cy - y * cx),
    )


@compiled()
def _earth_at(latitude, height, north, rate, factor):  # type: ignore[no-untyped-def]
    """Returns properties of the Earth at a point `north` metres north of a latitude: 1/(radius + height) in the meridian and in the
    prime vertical, secant and tangent of the latitude, gravity, and the north and up components of the Earth's rate."""
    sine, cosine = math.sin(latitude), math.cos(latitude)
    w = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    w *= math.sqrt(w)
    turn = north * w / (_SEMI_LATUS_RECTUM + height * w)
    sine, cosine = sine + turn * (cosine - 0.5 * turn * sine), cosine - turn * (sine + 0.5 * turn * cosine)
    squared = sine * sine
    root = 1.0 / math.sqrt(1.0 - ECCENTRICITY_SQUARED * squared)
    h = height * (1.0 / SEMI_MAJOR_AXIS)
    gravity = factor * GRAVITY_AT_EQUATOR * (1.0 + SOMIGLIANA * squared) * root
    gravity *= 1.0 - 2.0 * (1.0 + FLATTENING + ROTATION_RATIO - 2.0 * FLATTENING * squared) * h + 3.0 * h * h
    to_north = 1.0 / (_SEMI_LATUS_RECTUM * root * root * root + height)
    to_east = 1.0 / (SEMI_MAJOR_AXIS * root + height)
    secant = 1.0 / cosine
    return to_north, to_east, secant, sine * secant, gravity, rate * cosine, rate * sine


@compiled()
def _half_angle(x):  # type: ignore[no-untyped-def]
    """Returns sin(φ/2)/φ and cos(φ/2) for φ² = x."""
    if x < _SMALL:
        return (
            0.5 - x * (1.0 / 48.0 - x * (1.0 / 3840.0 - x * (1.0 / 645120.0))),
            1.0 - x * (1.0 / 8.0 - x * (1.0 / 384.0 - x * (1.0 / 46080.0))),
        )
    angle = math.sqrt(x)
    return math.sin(0.5 * angle) / angle, math.cos(0.5 * angle)


@compiled()
def _product(p, q):  # type: ignore[no-untyped-def]
    """Returns the product p ∘ q of two quaternions."""
    p0, p1, p2, p3 = p
    q0, q1, q2, q3 = q
    return (
        p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
        p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
        p0 * q2 + p2 * q0 + p3 * q1 - p1 * q3,
        p0 * q3 + p3 * q0 + p1 * q2 - p2 * q1,
    )


@compiled()
def _new_attitude(q, body, e, n, u):  # type: ignore[no-untyped-def]
    """Returns the attitude after the body has rotated by the rotation vector `body`, and the navigation axes have rotated by the
    rotation vector (e, n, u). The quaternion is normalised."""
    bx, by, bz = body
    s, c = _half_angle(bx * bx + by * by + bz * bz)
    turned = _product(q, (c, s * bx, s * by, s * bz))
    s, c = _half_angle(e * e + n * n + u * u)
    q0, q1, q2, q3 = _product((c, -s * e, -s * n, -s * u), turned)
    norm = 1.5 - 0.5 * (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    return norm * q0, norm * q1, norm * q2, norm * q3


@compiled()
def _new_velocity(v, d, place, dt, held):  # type: ignore[no-untyped-def]
    """Returns the velocity after an interval, and the rate of the navigation axes in the middle of the interval. `d`: velocity
    increment, in the navigation axes at the start of the interval. `place`: result of `_earth_at`."""
    ve, vn, vu = v
    de, dn, du = d
    to_north, to_east, _, tangent, gravity, earth_n, earth_u = place
    # half of the change gives the middle, where transport rate and Coriolis acceleration are computed
    e, n, u = -vn * to_north, earth_n + ve * to_east, earth_u + ve * to_east * tangent
    me = ve + 0.5 * (de - 0.5 * dt * (n * du - u * dn) + dt * ((u + earth_u) * vn - (n + earth_n) * vu))
    mn = vn + 0.5 * (dn - 0.5 * dt * (u * de - e * du) + dt * (e * vu - (u + earth_u) * ve))
    mu = vu if held else vu + 0.5 * (du - 0.5 * dt * (e * dn - n * de) + dt * ((n + earth_n) * ve - e * vn - gravity))
    e, n, u = -mn * to_north, earth_n + me * to_east, earth_u + me * to_east * tangent
    new_e = ve + de - 0.5 * dt * (n * du - u * dn) + dt * ((u + earth_u) * mn - (n + earth_n) * mu)
    new_n = vn + dn - 0.5 * dt * (u * de - e * du) + dt * (e * mu - (u + earth_u) * me)
    new_u = vu if held else vu + du - 0.5 * dt * (e * dn - n * de) + dt * ((n + earth_n) * me - e * mn - gravity)
    return new_e, new_n, new_u, e, n, u


@compiled()
def advance(state, increments, interval, aiding, earth, gains, held, every, knots):  # type: ignore[no-untyped-def]
    """Advances `state` (18,) in place over n samples; returns the number of knots (output points) that were written.

    `increments`: array of shape (6, n), increments of angle [rad] about the body axes x, y, z, and of velocity [m/s] along these
    axes. `interval`: array of shape (n,), length of the sampling intervals, s. `aiding`: array of shape (n,), reference height [m]
    for the damped vertical channel, or (1,) if it is constant. `earth`: (rotation rate [rad/s], factor on normal gravity). `gains`:
    array of shape (3,), gains of the third-order vertical loop [1/s, 1/s², 1/s³]; zeros for a free vertical channel. `held`: True
    if height and vertical velocity keep their values. `every`: number of steps between two knots, counted since the state was made.
    `knots`: array of shape (m, 10), which is filled with the output, one row for each knot.
    """
    q = (state[0], state[1], state[2], state[3])
    ve, vn, vu = state[4], state[5], state[6]
    latitude, longitude, height, loop = state[7], state[8], state[9], state[10]
    a, b = (state[11], state[12], state[13]), (state[14], state[15], state[16])
    steps, written = int(state[17]), 0
    for k in range(interval.size):
        dt = interval[k]
        t = (increments[0, k], increments[1, k], increments[2, k])
        u = (increments[3, k], increments[4, k], increments[5, k])
        rotation, d = _body_increments(t, u, a, b)
        a, b = t, u
        place = _earth_at(latitude, height + 0.5 * vu * dt, 0.5 * vn * dt, earth[0], earth[1])
        new_e, new_n, new_u, e, n, up = _new_velocity((ve, vn, vu), _turned(q, d), place, dt, held)
        if not held:
            error = height - aiding[min(k, aiding.size - 1)]
            height += dt * (0.5 * (vu + new_u) - gains[0] * error)
            new_u -= dt * (gains[1] * error + loop)
            loop += dt * gains[2] * error
        latitude += dt * 0.5 * (vn + new_n) * place[0]
        longitude += dt * 0.5 * (ve + new_e) * place[1] * place[2]
        ve, vn, vu = new_e, new_n, new_u
        q = _new_attitude(q, rotation, e * dt, n * dt, up * dt)
        steps += 1
        if steps % every == 0:
            row = knots[written]
            row[0], row[1], row[2], row[3] = q
            row[4], row[5], row[6] = ve, vn, vu
            row[7], row[8], row[9] = latitude, longitude, height
            written += 1
    state[0], state[1], state[2], state[3] = q
    state[4], state[5], state[6] = ve, vn, vu
    state[7], state[8], state[9], state[10] = latitude, longitude, height, loop
    state[11], state[12], state[13] = a
    state[14], state[15], state[16] = b
    state[17] = float(steps)
    return written
