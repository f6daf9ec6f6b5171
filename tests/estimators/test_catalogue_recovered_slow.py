"""The estimator `error_model` finds the effects of the catalogue in recordings of the independent generator (`tests.blind`).

Several effects of one unit with random matrices and biases are fitted at once. The 95 % intervals contain the truth, and predicted
uncertainties are those stated and the scatter of the errors. Effects within segments are in `effects_within`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from effects_within import GYRO, NAMES, SITE, World, campaign, rocks, timed, truth
from scipy.stats import binom

from tests.blind.motion import Fault
from tests.blind.plans import TWELVE, VERTICAL, Axes, Segment

ACCEL = ("accel_bias", "accel_scale_factor", "accel_misalignment")
FIELD = (0.0, 0.55, -0.83)
"""East, north, up, as in the generator's site."""
G, SITE_G = 9.80665, 9.80154
PPM, MICRO_G, ARCSEC = 1e6, 1e6 / G, 3600 * np.degrees(1.0)
PAIRS = ("xx", "yy", "zz", "xy", "yz", "zx")


def at(celsius: float, segments: Sequence[Segment]) -> list[Segment]:
    return [replace(one, label=f"{one.label}@{number}", chamber=celsius) for number, one in enumerate(segments)]


def places(axes: Sequence[Axes] = TWELVE, seconds: float = 5.0) -> list[Segment]:
    return [Segment(f"S{n}", "static", one, seconds) for n, one in enumerate(axes)]


def turns(*rates: float, seconds: float = 7.2) -> list[Segment]:
    """Whole turns about each axis, in both directions."""
    return [
        Segment(f"R{axis}{sign * rate:g}", "rate", axes, seconds, rate=sign * rate)
        for axis, axes in VERTICAL.items()
        for rate in rates
        for sign in (1, -1)
    ]


def oblique() -> list[Axes]:
    """24 attitudes with gravity between the axes, by turns about one axis of a cardinal attitude."""
    found: list[Axes] = []
    for angle in np.radians([20.0, 65.0, 110.0, 155.0, 200.0, 245.0, 290.0, 335.0]):
        c, s = float(np.cos(angle)), float(np.sin(angle))
        rows = ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))
        found += [(rows[k], rows[(k + 1) % 3], rows[(k + 2) % 3]) for k in range(3)]
    return found


PER_AXIS = {
    "gyro_scale_temperature": PPM,
    "gyro_scale_nonlinearity": 1.0,
    "gyro_scale_quadratic": PPM,
    "gyro_scale_asymmetry": PPM,
    "gyro_bias_temperature_cubic": 1.0,
    "gyro_bias_drift": 3600.0**2,
    "gyro_thermal_hysteresis": 1.0,
    "gyro_vibration_rectification": 1.0,
    "gyro_axis_delay": 1e3,
    "gyro_angular_acceleration": 1e3,
    "accel_bias_temperature": MICRO_G,
    "accel_scale_temperature": PPM,
    "accel_second_order": MICRO_G * (G / SITE_G) ** 2,
    "accel_third_order": MICRO_G * (G / SITE_G) ** 3,
    "accel_asymmetry": PPM,
    "accel_bias_drift": MICRO_G * 3600,
    "accel_thermal_hysteresis": 1e3 / G,
}
"""Reported unit over the generator's, which counts in deg/s, m/s², K, s and the site's g."""
MATRICES: dict[str, tuple[Sequence[str], float]] = {
    "gyro_g_sensitivity": ([f"K_{a}" for a in "xyz"], G / SITE_G),
    "gyro_g2_sensitivity": ([f"K_{pair}" for pair in PAIRS], (G / SITE_G) ** 2),
    "magnetic_sensitivity": ([f"K_{a}" for a in "xyz"], 1.0),
    "gyro_misalignment_temperature": ([f"towards_{a}" for a in "xyz"], ARCSEC),
    "accel_magnetic_sensitivity": ([f"K_{a}" for a in "xyz"], 1e3 / G),
    "accel_cross_coupling": ([f"K_{pair}" for pair in PAIRS[3:]], MICRO_G * (G / SITE_G) ** 2),
    "accel_misalignment_temperature": ([f"towards_{a}" for a in "xyz"], ARCSEC),
}
"""The same of effects with a row of parameters for each axis."""
OF_THE_TABLE: dict[str, tuple[Sequence[str], float]] = {
    "table_tilt": (("about_east", "about_north"), ARCSEC),
    "table_wobble": (("cos", "sin"), ARCSEC),
    "table_azimuth": (("about_up",), ARCSEC),
    "site_latitude": (("error",), float(np.degrees(1.0))),
    "table_rate_error": (("epsilon",), PPM),
}
"""The same of effects that all outputs have in common."""
SEPARABLE = {"gyro_g2_sensitivity": tuple(f"gyro_g2_sensitivity.K_{pair}" for pair in PAIRS if pair != "zz")}
"""The sum of the squares is constant and cannot be separated from the bias: K_zz is zero here."""


def true(world: World, seed: int) -> dict[str, float]:
    """Coefficient → value in the unit in which it is reported."""
    found = truth(world, seed)
    for name, fault in world.faults.items():
        if name in PER_AXIS:
            found |= {f"{name}_{a}": PER_AXIS[name] * one for a, one in zip("xyz", fault.theta, strict=True)}
        elif name in MATRICES:
            parameters, unit = MATRICES[name]
            for a, row in zip("xyz", fault.theta.reshape(3, -1), strict=True):
                found |= {f"{name}_{key}_{a}": unit * one for key, one in zip(parameters, row, strict=True)}
        elif name in OF_THE_TABLE:
            parameters, unit = OF_THE_TABLE[name]
            found |= {f"{name}_{key}": unit * one for key, one in zip(parameters, fault.theta, strict=True)}
        elif name == "gyro_bias_temperature":
            for key, row in zip(("c1", "c2"), fault.theta.reshape(2, 3), strict=True):
                found |= {f"{name}_{key}_{a}": one for a, one in zip("xyz", row, strict=True)}
    return found


def _matrix(size: float) -> list[float]:
    """Nine different values."""
    return [size * one for one in (1, -2, 3, -4, 5, -6, 7, -8, 9)]


def _hollow(size: float) -> list[float]:
    return [0.0 if n % 4 == 0 else one for n, one in enumerate(_matrix(size))]


def world(
    segments: Sequence[Segment],
    gyro: Mapping[str, Sequence[float]],
    accel: Mapping[str, Sequence[float]],
    without: Sequence[str] = (),
    axes: str = "xyz",
    **keys: Any,
) -> World:
    """Effects beside biases, scale factors and misalignments, except those in `without`, of the outputs along these axes. Drifts
    are excluded, as a plan may state: one that is taken for real by chance (1 recording in 32) increases the uncertainties."""
    faults = {name: Fault(name, np.array(theta, dtype=float)) for name, theta in {**gyro, **accel}.items()}
    outputs: dict[str, Sequence[str]] = {}
    for triad, base, effects in ((NAMES[:3], GYRO, gyro), (NAMES[3:], ACCEL, accel)):
        listed = [term for effect in effects for term in SEPARABLE.get(effect, (effect,))]
        if effects:
            outputs |= dict.fromkeys(
                [one for one in triad if one[-1] in axes], (*(one for one in base if one not in without), *listed)
            )
    site = replace(SITE, magnetic_field=FIELD)
    return World(timed(segments), faults, outputs, basis="within_segment", site=site, drift=("none",), **keys)


THREE_WAYS: tuple[Axes, ...] = (
    *(("up", "north", "west"), ("up", "west", "south"), ("up", "south", "east")),
    *(("north", "up", "east"), ("east", "up", "south"), ("south", "up", "west")),
    *(("north", "west", "up"), ("west", "south", "up"), ("south", "east", "up")),
)
"""Each axis up, the table's zero in three directions of the others: shows both parts of a wobble to each output."""
ROCKED = [*places(TWELVE[:6], 4.0), *turns(50, seconds=7.2), *rocks((8, 0.5), (2, 4), seconds=4.3)]
"""Whole turns: here each turn begins at angle zero, which no channel shows. The mean over another part of a turn would depend on it."""
WARM = [*places(), *turns(50, 150)]
WORLDS = {
    "rates and temperatures": world(
        [
            *at(25.0, [*WARM, *turns(100)]),
            *(one for celsius in (0.0, 25.0, 50.0) for one in at(celsius, [*places(TWELVE[:6]), *turns(150)])),
        ],
        {
            "gyro_bias_temperature": [1e-3, -2e-3, 3e-3, 1e-5, 2e-5, -1e-5],
            "gyro_scale_temperature": [1e-4, -5e-5, 2e-5],
            "gyro_scale_nonlinearity": [1e-8, -2e-8, 3e-8],
            "gyro_scale_asymmetry": [1e-4, -1e-4, 5e-5],
            "gyro_g_sensitivity": _matrix(0.01),
            "gyro_thermal_hysteresis": [5e-3, -5e-3, 1e-2],
            "magnetic_sensitivity": _matrix(1e-3),
        },
        {
            "accel_bias_temperature": [1e-3, 2e-3, -1e-3],
            "accel_scale_temperature": [1e-4, -1e-4, 2e-4],
            "accel_second_order": [1e-2, -1e-2, 2e-2],
            "accel_thermal_hysteresis": [1e-3, 2e-3, 3e-3],
        },
    ),
    "drift and four temperatures": world(
        [
            one
            for celsius in (25.0, 0.0, 50.0, 10.0, 25.0)
            for one in at(celsius, [*places(TWELVE[:6]), *turns(50, 150)])
        ],
        {
            "gyro_bias_temperature": [1e-3, -2e-3, 3e-3, 1e-5, 2e-5, -1e-5],
            "gyro_bias_temperature_cubic": [1e-6, 2e-6, -1e-6],
            "gyro_misalignment_temperature": _hollow(1e-6),
            "gyro_scale_quadratic": [1e-7, -2e-7, 3e-7],
            "gyro_bias_drift": [1e-5, -1e-5, 2e-5],
        },
        {
            "accel_misalignment_temperature": _hollow(1e-6),
            "accel_bias_drift": [1e-6, -2e-6, 3e-6],
        },
    ),
    "oblique attitudes": world(
        [*places(), *places(oblique()), *turns(50)],
        {"gyro_g2_sensitivity": [0.01 * one for k in (1, -2, 3) for one in (k, -k, 0, 2 * k, -2 * k, k)]},
        {
            "accel_second_order": [1e-2, -1e-2, 2e-2],
            "accel_third_order": [1e-2, -1e-2, 2e-2],
            "accel_asymmetry": [1e-3, -1e-3, 2e-3],
            "accel_cross_coupling": _matrix(1e-3),
        },
    ),
    "table": world(
        [
            *places((*TWELVE, *THREE_WAYS)),
            *(Segment(f"R{n}", "rate", axes, 7.2, rate=100.0) for n, axes in enumerate(THREE_WAYS)),
        ],
        {"table_wobble": [2e-4, -4e-4]},
        {"table_tilt": [4e-4, -2e-4]},
        spread=3e-4,
    ),
    "site and rates": world(
        [*places((*TWELVE, *THREE_WAYS), 10.0), *turns(50, 150)],
        {"table_azimuth": [0.01], "site_latitude": [-0.01], "table_rate_error": [1e-3]},
        {},
        without=("gyro_scale_factor",),
        spread=0.0,
        noisy=0.05,
    ),
    "magnetic field": world([*places(), *places(oblique())], {}, {"accel_magnetic_sensitivity": _matrix(1e-3)}),
    "rocking": world(
        ROCKED,
        {"gyro_vibration_rectification": [1e-5, -2e-5, 3e-5], "gyro_axis_delay": [3e-4, -2e-4, 1e-4]},
        {},
        axes="x",
    ),
    "angular acceleration": world(ROCKED, {"gyro_angular_acceleration": [2e-3, -1e-3, 3e-3]}, {}, axes="x"),
}
RUNS = 24


@pytest.mark.slow
@pytest.mark.parametrize("name", WORLDS)
def test_effects_are_found_within_their_predicted_uncertainties(name: str) -> None:
    found = campaign(WORLDS[name], range(1, 1 + RUNS), true)
    wrong = {one: own.stated / own.predicted for one, own in found.items() if abs(own.stated / own.predicted - 1) > 0.1}
    assert not wrong
    scatter = np.sqrt(np.mean([(one.scatter / one.predicted) ** 2 for one in found.values()]))
    errors = RUNS * len(found)
    assert scatter == pytest.approx(1.0, abs=max(0.1, 3 / np.sqrt(2 * errors)))
    # Each coefficient alone: no more outside than the binomial distribution allows all of them jointly at 0.1 %.
    least = float(binom.ppf(1e-3 / len(found), RUNS, 0.95)) / RUNS
    assert {one: own.covered for one, own in found.items() if own.covered < least} == {}
    assert np.mean([one.covered for one in found.values()]) == pytest.approx(
        0.95, abs=max(0.03, 3 * np.sqrt(0.95 * 0.05 / errors))
    )
