"""Recordings of gyros in a tilted fixture with known scale factors, made by formulas worked by hand, without the package's physics.

Home is x east, y north, z up, and the table turns about up. An axis at angle θ and azimuth α (from east towards north) that has turned by ψ
sees Ω·sin φ·cos θ of the Earth's vertical rate and Ω·cos φ·sin θ·sin(α + ψ) of its horizontal one; over a turn from ψ₀ by Θ the sine's mean
is (cos(α + ψ₀) − cos(α + ψ₀ + Θ))/Θ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from recorded import from_means, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.estimators.tilted.parameters import ScaleFactorTiltedParameters
from planrunner.estimators.tilted.scale_factor_tilted import ScaleFactorTilted
from planrunner.physics.earth import Site
from planrunner.plan.model import MountedAxis
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.uncertainty.influences import InputQuantity, Inputs

DEG, HOUR = math.pi / 180, math.pi / 180 / 3600
EARTH = 15.041067  # deg/h
SITE = Site(math.radians(40.0))
RATES = tuple(sign * rate for rate in (300.0, 150.0, 60.0, 20.0, 10.0, 1.0) for sign in (1, -1))
THETA = 54.735610317245346
TRIAD = {"x": (THETA, 0.0), "y": (THETA, 120.0), "z": (THETA, 240.0)}
HOME = np.eye(3)


@dataclass(frozen=True)
class Gyro:
    """True values. K: deg/s per deg/s; slope: relative, 1/K about 20 degC; bias, offset (of turning only): deg/s; asymmetry: relative."""

    K: float = 1.0
    slope: float = 0.0
    bias: float = 0.0
    offset: float = 0.0
    asymmetry: float = 0.0


def mean_sine(start: float, turned: float) -> float:
    """Of the angle from start over `turned`, rad."""
    return math.sin(start) if turned == 0 else (math.cos(start) - math.cos(start + turned)) / turned


def earth(angle: float, azimuth: float, start: float, turned: float, latitude: float = 40.0) -> float:
    """deg/s on an axis; angle, azimuth, latitude in deg, start and turned in rad."""
    horizontal = EARTH * math.cos(latitude * DEG) * math.sin(angle * DEG)
    vertical = EARTH * math.sin(latitude * DEG) * math.cos(angle * DEG)
    return (vertical + horizontal * mean_sine(azimuth * DEG + start, turned)) / 3600


def whole_turns(rate: float, least: float = 30.0) -> float:
    period = 360 / abs(rate)
    return max(1, math.ceil(least / period - 1e-9)) * period


def series(
    mounting: Mapping[str, tuple[float, float]],
    gyros: Mapping[str, Gyro],
    celsius: float | None = 20.0,
    repeat: int = 1,
    rates: Sequence[float] = RATES,
    dwell: Callable[[float], float] = whole_turns,
    noise: Callable[[str, float], float] = lambda axis, seconds: 0.0,
    error: float = 0.0,
    rate_error: Mapping[float, float] | None = None,
    settle: float = 0.0,
    drift: float = 0.0,
) -> list[RecordedSegment]:
    """Start zero, rates, end zero. noise: added to the mean of an axis over so many seconds; error: standard error stated with each mean;
    rate_error: relative, by rate; settle: s; drift: deg/s from start to end zero."""
    kelvin = None if celsius is None else celsius + 273.15
    prefix = f"{celsius:g}degC/r{repeat}" if celsius is not None else f"r{repeat}"
    made = []
    steps = [("start-zero", 0.0), *((f"R{rate:+g}", rate) for rate in rates), ("end-zero", 0.0)]
    for place, (label, rate) in enumerate(steps):
        seconds = dwell(rate) if rate else 60.0
        motion = Spin(rate * DEG) if rate else Rest()
        planned = Segment(0, f"{prefix}/{label}", HOME, "home", motion, seconds, settle, temperature=kelvin)
        means = {}
        for axis, (angle, azimuth) in mounting.items():
            gyro = gyros[axis]
            own = gyro.K * (1 + gyro.slope * ((celsius if celsius is not None else 20.0) - 20))
            true = rate * (1 + (rate_error or {}).get(rate, 0.0))
            felt = true * math.cos(angle * DEG) + earth(angle, azimuth, rate * DEG * settle, rate * DEG * seconds)
            value = own * (felt + gyro.asymmetry / 2 * abs(felt)) + gyro.bias + (gyro.offset if rate else 0.0)
            means[f"gyro_{axis}"] = value + noise(axis, seconds) + drift * place / (len(steps) - 1)
        made.append(sampled(planned, means, error))
    return made


def sampled(planned: Segment, means: Mapping[str, float], error: float = 0.0) -> RecordedSegment:
    """Means over the whole dwell, as samples at 10 Hz that each stand for the interval before them."""
    assert planned.dwell is not None
    count = round(10 * planned.dwell)
    made = from_means(planned, means, "deg/s", error, count=count)
    return replace(made, statistics=replace(made.statistics, end=planned.dwell * (count - 1) / count))


def plan_mounting(axes: Mapping[str, tuple[float, float | None]], arcsec: float = 0.0) -> dict[str, MountedAxis]:
    return {
        name: MountedAxis(
            angle=parse_quantity(f"{angle!r} deg ± {arcsec} arcsec" if arcsec else f"{angle!r} deg"),
            azimuth=None if azimuth is None else parse_quantity(f"{azimuth!r} deg"),
        )
        for name, (angle, azimuth) in axes.items()
    }


def inputs(
    axes: Mapping[str, tuple[float, float | None]], arcsec: float, rate: float = 0.0, flicker: float = 0.0
) -> Inputs:
    """arcsec: of each angle; rate: relative; flicker: bias instability of each output, deg/h."""
    held = {
        f"fixture angle {name}": InputQuantity(f"fixture angle {name}", angle * DEG, "rad", arcsec * HOUR)
        for name, (angle, _) in axes.items()
        if arcsec
    }
    if rate:
        held["table rate"] = InputQuantity("table rate", 0.0, "1", rate)
    if flicker:
        for name in (f"bias instability gyro_{axis}" for axis in axes):
            held[name] = InputQuantity(name, 0.0, "deg/s", flicker / 3600)
    return Inputs(held)


def estimate(
    recorded: Sequence[RecordedSegment],
    axes: Mapping[str, tuple[float, float | None]],
    stated: Inputs | None = None,
    uses: Mapping[str, Estimate] | None = None,
    site: Site = SITE,
    **keys: Any,
) -> Estimate:
    """With its influences added, as an analysis does."""
    setup = Setup(None, plan_mounting(axes), stated or Inputs())
    model = sensor(*(f"gyro_{name}" for name in axes), unit="deg/s")
    parameters = ScaleFactorTiltedParameters(**{"uncertainty": "residual", **keys})
    request = EstimateRequest("scale", tuple(recorded), parameters, site, model, uses or {}, None, setup)
    return combined(ScaleFactorTilted().estimate(request))


def turned_label(recorded: RecordedSegment, **changes: Any) -> RecordedSegment:
    return replace(recorded, segment=replace(recorded.segment, **changes))
