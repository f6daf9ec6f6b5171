"""Do the 95 % intervals that combine the data with stated inputs hold the truth 95 % of the time? Simulated campaigns.

`python tests/estimators/budget_coverage.py [runs] [name]` prints the figures of docs/uncertainty-budgets.md, or those with this in their
name. In every run the world differs from what is stated by draws from the stated distributions: latitude, gravity and azimuth once a run,
the table's error at every position, the error of every rate and one that all rates share; with white noise and flicker, which is declared
as it is, on top. The generators are written apart from planrunner.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from coverage_experiment import DWELL, GYRO, PAUSE, SAMPLES, flicker_in_segments
from recorded import played, segment, sensor
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, attitude
from test_stated_inputs_move_coefficients import currents, turn

from planrunner.estimators.analysis import combined
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Spin
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import InputQuantity, Inputs

ARCSEC = math.pi / 648000
UP = np.array([0.0, 0.0, 1.0])
RATES = np.array([sign * rate for rate in (300, 150, 60, 20, 10, 1) for sign in (1, -1)], dtype=float)  # deg/s
SLOPE, OFFSET = 1000.0, 3.0  # pulse/s per deg/s, pulse/s


@dataclass(frozen=True)
class Static:
    """One campaign with the eight positions. white: pulse/√s; flicker: pulse/s; position, latitude, azimuth: arcsec; gravity: m/s^2."""

    basis: str
    white: float = 0.9
    flicker: float = 0.0
    position: float = 3.0
    latitude: float = 1.0
    azimuth: float = 10.0
    gravity: float = 2e-5


@dataclass(frozen=True)
class Rates:
    """One campaign over rates. white, flicker: pulse/s of a mean; each, common: relative errors of the rates."""

    basis: str
    white: float = 1.5
    flicker: float = 0.0
    each: float = 1e-5
    common: float = 5e-6
    weights: str = "noise"


LOUD = {"white": 0.09, "position": 30.0, "latitude": 60.0, "azimuth": 60.0, "gravity": 1e-2}
STATIC = {
    "shipped bench": Static("residual", flicker=0.025),
    "shipped bench, noise within": Static("within_segment", flicker=0.025),
    "stated inputs large, noise ten times less": Static("residual", **LOUD),
    "stated inputs large, noise ten times less, noise within": Static("within_segment", **LOUD),
    "the same with flicker 0.0025 pulse/s, noise within": Static("within_segment", flicker=0.0025, **LOUD),
}
RATE = {
    "noise and rate errors alike": Rates("residual"),
    "noise and rate errors alike, noise within": Rates("within_segment"),
    "noise and rate errors alike, equal weights": Rates("residual", weights="equal"),
    "noise and rate errors alike, equal weights, noise within": Rates("within_segment", weights="equal"),
    "rate errors alone matter": Rates("residual", white=0.1),
    "rate errors alone matter, noise within": Rates("within_segment", white=0.1),
    "noise and rate errors alike, flicker 0.5 pulse/s": Rates("residual", flicker=0.5),
    "noise and rate errors alike, flicker 0.5 pulse/s, noise within": Rates("within_segment", flicker=0.5),
}


def static_coverage(campaign: Static, runs: int, seed: int) -> dict[str, float]:
    """Share of runs whose interval holds the truth, by coefficient."""
    widths = {
        "latitude": campaign.latitude * ARCSEC,
        "gravity": campaign.gravity,
        "azimuth": campaign.azimuth * ARCSEC,
        "table position": campaign.position * ARCSEC,
    } | {f"bias instability {name}": campaign.flicker for name in CHANNELS if campaign.flicker}
    setup = Setup(inputs=Inputs({name: InputQuantity(name, 0.0, "rad", width) for name, width in widths.items()}))
    rng = np.random.default_rng(seed)
    parameters = FlexureGyroStaticParameters(uncertainty=campaign.basis)
    hits = dict.fromkeys(GYRO, 0)
    for start in range(0, runs, 250):
        slow = flicker_in_segments(rng, (250, 2), campaign.flicker) if campaign.flicker else np.zeros((250, 1, 1, 1))
        for n in range(min(250, runs - start)):
            north = turn(UP, widths["azimuth"] * rng.normal())
            keys = {
                "latitude": SITE.latitude + widths["latitude"] * rng.normal(),
                "gravity": SITE.gravity + widths["gravity"] * rng.normal(),
            }
            noise = campaign.white / math.sqrt(DWELL / SAMPLES) * rng.normal(size=(2, 8, SAMPLES)) + slow[n]
            recorded = []
            for k, (label, words) in enumerate(OPTIMAL.items()):
                axes = turn(rng.normal(size=3), widths["table position"]) @ attitude(words) @ north
                means = currents(axes, truth=GYRO, **keys)
                planned = replace(segment(label, attitude(words)), orientation=words)
                named = dict(zip(CHANNELS, means, strict=True))
                recorded.append(played(planned, named, noise[:, k], "pulse/s", k * (DWELL + PAUSE)))
            request = EstimateRequest("d", tuple(recorded), parameters, SITE, sensor(*CHANNELS), setup=setup)
            count(combined(FlexureGyroStatic().estimate(request)), GYRO, hits)
    return {name: found / runs for name, found in hits.items()}


def rate_coverage(campaign: Rates, runs: int, seed: int) -> dict[str, float]:
    stated = {"table rate": InputQuantity("table rate", 0.0, "1", campaign.each)}
    if campaign.flicker:
        stated["bias instability gyro"] = InputQuantity("bias instability gyro", 0.0, "pulse/s", campaign.flicker)
    setup = Setup(inputs=Inputs(stated))
    parameters = ScaleFactorParameters(
        outputs=("gyro",),
        weights=campaign.weights,
        uncertainty=campaign.basis,
        rate_uncertainty=parse_quantity(f"{campaign.common * 1e6:g} ppm"),
    )
    rng = np.random.default_rng(seed)
    truth = {"K_gyro": SLOPE, "F0_gyro": OFFSET}
    hits = dict.fromkeys(truth, 0)
    planned = [segment(f"R{n}", motion=Spin(math.radians(rate))) for n, rate in enumerate(RATES)]
    for start in range(0, runs, 250):
        count_of = min(250, runs - start)
        slow = np.zeros((count_of, len(RATES), SAMPLES))
        if campaign.flicker:
            slow = flicker_in_segments(rng, (count_of,), campaign.flicker, len(RATES))
        for n in range(count_of):
            noise = campaign.white * math.sqrt(SAMPLES) * rng.normal(size=(len(RATES), SAMPLES)) + slow[n]
            really = RATES * (1 + campaign.common * rng.normal() + campaign.each * rng.normal(size=len(RATES)))
            recorded = tuple(
                played(one, {"gyro": mean}, noise[place, None], "pulse/s", place * (DWELL + PAUSE))
                for place, (one, mean) in enumerate(zip(planned, (OFFSET + SLOPE * really).tolist(), strict=True))
            )
            request = EstimateRequest("s", recorded, parameters, SITE, sensor("gyro"), setup=setup)
            count(combined(ScaleFactor().estimate(request)), truth, hits)
    return {name: found / runs for name, found in hits.items()}


def count(estimate: Estimate, truth: dict[str, float], hits: dict[str, int]) -> None:
    for name, value in truth.items():
        item = estimate[name]
        hits[name] += abs(item.value - value) <= expanded_uncertainty(
            item.standard_uncertainty, item.degrees_of_freedom
        )


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    only = sys.argv[2] if len(sys.argv) > 2 else ""
    print(f"{runs} runs each; coverage in %, lowest and highest over the coefficients")
    campaigns = {f"static_coverage, {name}": partial(static_coverage, one) for name, one in STATIC.items()}
    campaigns |= {f"rate_coverage, {name}": partial(rate_coverage, one) for name, one in RATE.items()}
    for name, covered in campaigns.items():
        if only in name:
            found = covered(runs, 20)
            low, high = min(found, key=found.__getitem__), max(found, key=found.__getitem__)
            shown = f"{100 * found[low]:.1f} ({low}) … {100 * found[high]:.1f} ({high})"
            print(f"{name}: {shown}", flush=True)


if __name__ == "__main__":
    main()
