"""How often the 95 % intervals of an IMU's coefficients and of curves over temperature hold the truth, over simulated tests.

`python tests/estimators/calibration_coverage.py [runs]` prints the figures of docs/imu-calibration.md and docs/temperature-models.md.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import simulated_imu as imu
from recorded import sensor

from planrunner.estimators.imu.imu_multi_position import ImuMultiPosition, ImuMultiPositionParameters
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.estimators.temperature.curve import fit_curve, groups_of
from planrunner.uncertainty.budget import Measured, combine
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import InputQuantity, Inputs

ARCSEC = math.radians(1) / 3600
CHANNELS = (*imu.GYROS, *imu.ACCELS)
# Straight, plainly curved, and curved by little more than the scatter: the hardest for a choice of order.
CURVES = ((3.0, 0.05), (3.0, 0.05, -1e-3), (3.0, 0.05, -2e-5), (3.0, 0.05, -4e-5))


def imu_coverage(runs: int, seed: int, basis: str, tilt: float = 0.0, stated: float = 0.0) -> dict[str, float]:
    """Share of runs by coefficient. tilt: of each orientation, arcsec, the same whenever it is taken; stated: what the bench says of it."""
    draw, segments = np.random.default_rng(seed), imu.plan()
    inputs = Inputs({"table position": InputQuantity("table position", 0.0, "rad", stated * ARCSEC)} if stated else {})
    parameters = ImuMultiPositionParameters(gyros=imu.GYROS, accelerometers=imu.ACCELS, uncertainty=basis)
    hits: dict[str, int] = {}
    for _ in range(runs):
        truth = imu.drawn_truth(draw)
        recorded = imu.recorded(segments, truth, draw, tilt=tilt * ARCSEC)
        request = EstimateRequest("imu", recorded, parameters, imu.SITE, sensor(*CHANNELS), setup=Setup(inputs=inputs))
        found = ImuMultiPosition().estimate(request)
        u, freedom = zip(
            *((item.standard_uncertainty, item.degrees_of_freedom) for item in found.coefficients), strict=True
        )
        if stated:
            measured = [
                Measured(item.name, item.value, item.unit, item.standard_uncertainty, item.degrees_of_freedom)
                for item in found.coefficients
            ]
            sums = combine(measured, found.covariance, found.influences)
            u, freedom = tuple(sums.standard_uncertainties), tuple(sums.degrees_of_freedom)
        expected = imu.named(truth)
        for item, own, dof in zip(found.coefficients, u, freedom, strict=True):
            held = abs(item.value - expected[item.name]) <= expanded_uncertainty(float(own), float(dof))
            hits[item.name] = hits.get(item.name, 0) + int(held)
    return {name: count / runs for name, count in hits.items()}


def curve_coverage(
    runs: int, seed: int, temperatures: int, truth: tuple[float, ...], order: int | None, scatter: float = 0.05
) -> tuple[float, float]:
    """Share of runs in which the interval holds the polynomial `truth`: lowest and highest over 21 temperatures of the range −40 … 60 degC.

    scatter: of the values; the curve's coefficients are of T − 25 degC. order: None lets held-out error choose it.
    """
    draw = np.random.default_rng(seed)
    t, grid = np.linspace(-40, 60, temperatures), np.linspace(-40, 60, 21)
    exact, wanted = (np.polynomial.polynomial.polyval(one - 25, truth) for one in (t, grid))
    sigma, alone = np.ones(temperatures), np.full(temperatures, -1)
    group, hits = groups_of(t, 1.0), np.zeros(grid.size)
    for _ in range(runs):
        y = exact + scatter * draw.standard_normal(temperatures)
        fit = fit_curve("polynomial", order, 4, 25.0, t, y, sigma, group, 0, "one_standard_error", True, alone)
        value, u = fit.predict(grid)
        hits += np.abs(value - wanted) <= expanded_uncertainty(1.0, fit.degrees_of_freedom) * u
    return float(hits.min() / runs), float(hits.max() / runs)


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print(f"{runs} runs each; lowest and highest coverage, in %")
    for words, keys in (
        ("white noise, residual basis", {"basis": "residual"}),
        ("white noise, within-segment basis", {"basis": "within_segment"}),
        ("and tilts of 5 arcsec, stated, residual basis", {"basis": "residual", "tilt": 5.0, "stated": 5.0}),
        (
            "and tilts of 5 arcsec, stated, within-segment basis",
            {"basis": "within_segment", "tilt": 5.0, "stated": 5.0},
        ),
        ("and tilts of 5 arcsec, not stated, within-segment basis", {"basis": "within_segment", "tilt": 5.0}),
    ):
        found = imu_coverage(runs, 30, **keys)  # type: ignore[arg-type]
        low, high = min(found, key=found.get), max(found, key=found.get)  # type: ignore[arg-type]
        print(f"imu, {words}: {100 * found[low]:.1f} ({low}) … {100 * found[high]:.1f} ({high})", flush=True)
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
