"""How often the 95 % intervals of an IMU's coefficients and of curves over temperature hold the truth, over simulated tests.

`python tests/estimators/calibration_coverage.py [runs]` prints the figures of docs/imu-calibration.md and docs/temperature-models.md.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import simulated_imu as imu
from coverage_experiment import flicker_in_segments
from recorded import noisy, segment, sensor

from planrunner.estimators.analysis import combined
from planrunner.estimators.imu.imu_multi_position import ImuMultiPosition, ImuMultiPositionParameters
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.estimators.outputs_fit import BASES
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.estimators.temperature.temperature_model import TemperatureModel
from planrunner.plan.quantity import parse_quantity
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import InputQuantity, Inputs

IMU: dict[str, dict[str, float]] = {
    "white noise": {},
    "tilts of 5 arcsec, stated": {"tilt": 5.0, "stated": 5.0},
    "tilts of 5 arcsec, stated as 2.5": {"tilt": 5.0, "stated": 2.5},
    "tilts of 5 arcsec, not stated": {"tilt": 5.0},
    "flicker, declared": {"flicker": 1.0, "declared": 1.0},
    "flicker, declared too small by 2": {"flicker": 1.0, "declared": 0.5},
    "flicker, not declared": {"flicker": 1.0},
    "flicker and tilts of 5 arcsec, both stated": {"flicker": 1.0, "declared": 1.0, "tilt": 5.0, "stated": 5.0},
}
ARCSEC = math.radians(1) / 3600
CHANNELS = (*imu.GYROS, *imu.ACCELS)
# Straight, plainly curved, and curved by little more than the scatter: the hardest for a choice of order.
CURVES = ((3.0, 0.05), (3.0, 0.05, -1e-3), (3.0, 0.05, -2e-5), (3.0, 0.05, -4e-5))


FLICKER = {name: size for names, size in ((imu.GYROS, imu.DEG_H), (imu.ACCELS, 2e-5)) for name in names}
SPAN = 6 * 3600.0  # s, over which constants are to hold here


def imu_coverage(
    runs: int, seed: int, tilt: float = 0.0, stated: float = 0.0, flicker: float = 0.0, declared: float = 0.0
) -> dict[str, dict[str, float]]:
    """Share of runs by basis and coefficient. tilt: of each orientation, arcsec, the same whenever it is taken; flicker: in units of
    `FLICKER`, 1 deg/h and 2 µg; stated, declared: what the bench says of both."""
    draw, segments = np.random.default_rng(seed), imu.plan()
    known = [InputQuantity("table position", 0.0, "rad", stated * ARCSEC)] if stated else []
    known += [
        InputQuantity(f"bias instability {one}", 0.0, "", declared * FLICKER[one]) for one in CHANNELS if declared
    ]
    setup = Setup(inputs=Inputs({one.name: one for one in known}))
    span = parse_quantity(f"{SPAN / 3600:g} h")
    hits: dict[str, dict[str, int]] = {basis: {} for basis in BASES}
    sizes = np.array([[[FLICKER[one]]] for one in CHANNELS]) * flicker
    for _ in range(runs):
        truth = imu.drawn_truth(draw)
        slow = sizes * flicker_in_segments(draw, (6,), 1.0, len(segments), 60.0, 30.0, SPAN) if flicker else None
        recorded = imu.recorded(segments, truth, draw, tilt=tilt * ARCSEC, flicker=slow)
        expected = imu.named(truth)
        for basis, counts in hits.items():
            parameters = ImuMultiPositionParameters(
                gyros=imu.GYROS, accelerometers=imu.ACCELS, uncertainty=basis, drift_span=span
            )
            request = EstimateRequest("imu", recorded, parameters, imu.SITE, sensor(*CHANNELS), setup=setup)
            for item in combined(ImuMultiPosition().estimate(request)).coefficients:
                width = expanded_uncertainty(item.standard_uncertainty, item.degrees_of_freedom)
                counts[item.name] = counts.get(item.name, 0) + int(abs(item.value - expected[item.name]) <= width)
    return {basis: {name: count / runs for name, count in counts.items()} for basis, counts in hits.items()}


def curve_coverage(
    runs: int, seed: int, temperatures: int, truth: tuple[float, ...], order: int | None, scatter: float = 0.05
) -> tuple[float, float]:
    """Share of runs in which the interval holds the polynomial `truth`: lowest and highest over 21 temperatures of the range −40 … 60 degC.

    Each run records samples at constant temperatures. scatter: of the means; the curve's coefficients are of T − 25 degC. order: None lets
    held-out error choose it.
    """
    draw, model = np.random.default_rng(seed), sensor("gyro", unit="deg/s")
    t, grid = np.linspace(-40, 60, temperatures), np.linspace(-40, 60, 21)
    exact, wanted = (np.polynomial.polynomial.polyval(one - 25, truth) for one in (t, grid))
    parameters = TemperatureModelParameters(channels=("gyro",), order=order)
    planned = [replace(segment(f"T{one:+.1f}"), temperature=one + 273.15, start=300.0 * k) for k, one in enumerate(t)]
    hits = np.zeros(grid.size)
    for _ in range(runs):
        recorded = tuple(
            noisy(one, {"gyro": value}, "deg/s", scatter, draw, one.start or 0.0, samples=64)
            for one, value in zip(planned, exact.tolist(), strict=True)
        )
        found = TemperatureModel().estimate(EstimateRequest("curve", recorded, parameters, imu.SITE, model))
        powers = np.vander(grid - 25, len(found.coefficients), increasing=True)
        value = powers @ [one.value for one in found.coefficients]
        u = np.sqrt(np.einsum("ij,jk,ik->i", powers, found.covariance, powers))
        hits += np.abs(value - wanted) <= expanded_uncertainty(1.0, found.coefficients[0].degrees_of_freedom) * u
    return float(hits.min() / runs), float(hits.max() / runs)


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print(f"{runs} runs each; lowest and highest coverage, in %")
    for words, keys in IMU.items():
        for basis, found in imu_coverage(runs, 30, **keys).items():
            low, high = min(found, key=found.__getitem__), max(found, key=found.__getitem__)
            print(
                f"imu, {words}, {basis}: {100 * found[low]:.1f} ({low}) … {100 * found[high]:.1f} ({high})", flush=True
            )
    for temperatures in (6, 11, 21):
        for truth in CURVES:
            for order in (len(truth) - 1, None):
                low_, high_ = curve_coverage(runs, 31, temperatures, truth, order)
                chosen = "chosen" if order is None else "given"
                print(
                    f"curve, {temperatures} temperatures, {truth}, order {chosen}: {100 * low_:.1f} … {100 * high_:.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
