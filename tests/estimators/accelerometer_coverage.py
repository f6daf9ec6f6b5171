"""Do the 95 % intervals of an accelerometer triad hold the truth 95 % of the time, against gravity in known attitudes and by its magnitude?

`python tests/estimators/accelerometer_coverage.py [runs [part of a name]]` prints the figures of docs/imu-calibration.md. Readings come
from a bias and a response drawn anew in each run, gravity turned into the sensor's axes here, white noise and flicker of every sample; what
is true are lengths of the rows of that response and angles between them. Nothing is taken from planrunner's physics.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from coverage_experiment import SAMPLES, flicker_in_segments
from recorded import played, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.estimators.outputs_fit import BASES
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import InputQuantity, Inputs

CHANNELS = ("accel_x", "accel_y", "accel_z")
SITE = Site(math.radians(40.0), 9.80)
GRAVITY = 9.80 / 9.80665  # g, of the readings
ARCSEC, MRAD = math.pi / 648000, 1e-3
DWELL, PAUSE = 60.0, 30.0
SPAN = 6 * 3600.0  # s, over which biases are to hold
WHITE = 1e-5  # g, of the mean over a position


@dataclass(frozen=True)
class World:
    """flicker: bias instability of each channel, g; tilt: of each orientation about each axis, arcsec, the same whenever it is taken;
    declared, stated: what the bench says of both."""

    flicker: float = 0.0
    declared: float = 0.0
    tilt: float = 0.0
    stated: float = 0.0


FLICKER = 1e-5
SCENARIOS: dict[str, dict[str, World]] = {
    "orientation": {
        "white noise": World(),
        "flicker, declared": World(FLICKER, FLICKER),
        "positions off by 5 arcsec, stated": World(tilt=5.0, stated=5.0),
        "flicker and positions off by 5 arcsec, both stated": World(FLICKER, FLICKER, 5.0, 5.0),
        "flicker, not declared": World(FLICKER),
        "positions off by 5 arcsec, not stated": World(tilt=5.0),
    },
    "gravity_magnitude": {
        "white noise": World(),
        "flicker, declared": World(FLICKER, FLICKER),
        "flicker, declared, and positions off by 1 deg, not stated": World(FLICKER, FLICKER, 3600.0),
        "flicker, not declared": World(FLICKER),
    },
}


def cardinal_attitudes() -> list[np.ndarray]:
    """The 24 right-handed ways in which the sensor's axes lie along east, north and up; rows are the axes."""
    signed = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return [one for one in signed if np.linalg.det(one) > 0]


def spread_attitudes(count: int = 24) -> list[np.ndarray]:
    """Attitudes that a hand may have chosen; fixed."""
    draw = np.random.default_rng(1)
    found = [np.linalg.qr(draw.normal(size=(3, 3)))[0] for _ in range(count)]
    return [one * np.sign(np.linalg.det(one)) for one in found]


# Twelve of the cardinal ones: each axis is twice up and twice down.
ATTITUDES = {"orientation": cardinal_attitudes()[::2], "gravity_magnitude": spread_attitudes()}


def skew(turn: np.ndarray) -> np.ndarray:
    return np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])


def rotated(turn: np.ndarray) -> np.ndarray:
    """exp of the cross product with `turn`, rad, by Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return np.eye(3)
    cross = skew(turn / angle)
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def truth_of(reference: str, bias: np.ndarray, response: np.ndarray) -> dict[str, float]:
    """Biases in mg, scale factors, angles in mrad."""
    length = np.linalg.norm(response, axis=1)
    known = {f"bias_{a}": 1e3 * bias[i] for i, a in enumerate("xyz")} | {
        f"scale_{a}": length[i] for i, a in enumerate("xyz")
    }
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            if reference == "orientation" and i != j:
                known[f"misalignment_{a}_{b}"] = response[i, j] / length[i] / MRAD
            if reference == "gravity_magnitude" and i < j:
                between = math.acos(float(response[i] @ response[j]) / (length[i] * length[j]))
                known[f"gamma_{a}{b}"] = (math.pi / 2 - between) / MRAD
    return known


def recorded(
    draw: np.random.Generator,
    attitudes: Sequence[np.ndarray],
    bias: np.ndarray,
    response: np.ndarray,
    world: World,
) -> tuple[RecordedSegment, ...]:
    """One test, readings in g."""
    n = len(attitudes)
    noise = WHITE * math.sqrt(SAMPLES) * draw.standard_normal((3, n, SAMPLES))
    if world.flicker:
        noise = noise + flicker_in_segments(draw, (3,), world.flicker, n, DWELL, PAUSE, SPAN)
    made = []
    for k, planned in enumerate(attitudes):
        real = rotated(world.tilt * ARCSEC * draw.standard_normal(3)) @ planned
        values = bias + response @ real[:, 2] * GRAVITY
        one = replace(segment(f"P{k}", planned, dwell=DWELL), orientation=f"attitude {k}")
        means = dict(zip(CHANNELS, map(float, values), strict=True))
        made.append(played(one, means, noise[:, k], "g", k * (DWELL + PAUSE)))
    return tuple(made)


def coverage(reference: str, world: World, runs: int, seed: int) -> dict[str, dict[str, float]]:
    """Share of runs whose interval holds the truth, by basis and coefficient."""
    draw, attitudes = np.random.default_rng(seed), ATTITUDES[reference]
    known = [InputQuantity(f"bias instability {one}", 0.0, "g", world.declared) for one in CHANNELS if world.declared]
    if world.stated:
        known.append(InputQuantity("table position", 0.0, "rad", world.stated * ARCSEC))
    setup = Setup(inputs=Inputs({one.name: one for one in known}))
    hits: dict[str, dict[str, int]] = {basis: {} for basis in BASES}
    span = parse_quantity(f"{SPAN / 3600:g} h")
    for _ in range(runs):
        bias, response = 0.01 * draw.standard_normal(3), np.eye(3) + 0.003 * draw.standard_normal((3, 3))
        segments = recorded(draw, attitudes, bias, response, world)
        truth = truth_of(reference, bias, response)
        for basis, counts in hits.items():
            parameters = AccelerometerMultiPositionParameters(reference=reference, uncertainty=basis, drift_span=span)
            request = EstimateRequest("a", segments, parameters, SITE, sensor(*CHANNELS, unit="g"), setup=setup)
            found = combined(AccelerometerMultiPosition().estimate(request))
            assert {item.name for item in found.coefficients} == set(truth)
            for item in found.coefficients:
                width = expanded_uncertainty(item.standard_uncertainty, item.degrees_of_freedom)
                counts[item.name] = counts.get(item.name, 0) + int(abs(item.value - truth[item.name]) <= width)
    return {basis: {name: count / runs for name, count in counts.items()} for basis, counts in hits.items()}


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    only = sys.argv[2] if len(sys.argv) > 2 else ""
    print(f"{runs} runs each; lowest and highest coverage over the coefficients, in %")
    for reference, worlds in SCENARIOS.items():
        for name, world in worlds.items():
            if only not in f"{reference}, {name}":
                continue
            for basis, found in coverage(reference, world, runs, 60).items():
                low, high = min(found, key=found.__getitem__), max(found, key=found.__getitem__)
                shown = f"{100 * found[low]:.1f} ({low}) … {100 * found[high]:.1f} ({high})"
                print(f"{reference}, {name}, {basis}: {shown}", flush=True)


if __name__ == "__main__":
    main()
