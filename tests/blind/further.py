"""Cases of further kinds, which the campaign does not draw, so that a seed keeps its cases: `make --further`.

    triple        three effects, none of which reproduces more than half of another
    step          a step of a bias
    counts        gyros whose counts are 3 to 30 standard deviations of their noise
    late          a lag or a delay of the gyros
    coloured      noise that is filtered or differenced, without or with one effect
    mislabelled   a channel with the wrong sign, the wrong unit, or the name of another
    none          nothing

The label of such a case states its kind as `variety`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.blind.device import SENSORS
from tests.blind.effects import CATALOGUE, KINDS
from tests.blind.generator import (
    STRONGEST,
    WEAKEST,
    Case,
    Work,
    channel_names,
    effects_apart,
    label_of,
    one_effect,
    signatures,
    simulate,
    stream,
    surroundings,
)
from tests.blind.motion import Array, Fault
from tests.blind.plans import PLANS

COMPOSITION = {
    "none": 0.10,
    "triple": 0.20,
    "step": 0.15,
    "counts": 0.15,
    "late": 0.15,
    "coloured": 0.10,
    "mislabelled": 0.15,
}
ROCKING = tuple(name for name, rows in PLANS.items() if any(row.kind == "rock" for row in rows))
SETUPS = {
    "late": (ROCKING, tuple(SENSORS)),
    "triple": (("rocking", "thermal", "rich"), tuple(SENSORS)),
    "counts": (("tumble", "rates", "rocking", "rich"), tuple(SENSORS)),
    "mislabelled": (("rates", "rich"), ("mems",)),
}
"""Plans and sensors that can show a kind, where not all can."""
WEAKEST_OF_THREE = 200.0
COARSE = (3.0, 30.0)  # σ
COLOURS = ((1.0, -0.75), (1.0, 1.0), (1.0, 0.7, 0.4))
"""Responses of the filters: one that differences, and two that smooth. Each leaves the standard deviation of a sample as it is."""
_DRAW = 7  # part of a case's random numbers: different from those of the campaign


def assigned(seed: int, number: int) -> tuple[str, str, str]:
    """Plan, sensor type and kind of case `number`."""
    rng = stream(seed, number, _DRAW)
    kind = str(rng.choice(list(COMPOSITION), p=list(COMPOSITION.values())))
    plans, sensors = SETUPS.get(kind, (tuple(PLANS), tuple(SENSORS)))
    return plans[rng.integers(len(plans))], sensors[rng.integers(len(sensors))], kind


def make(seed: int, number: int) -> Case:
    """Case `number`."""
    plan, sensor_name, kind = assigned(seed, number)
    rng = stream(seed, number, _DRAW + 1)
    factors, device = surroundings(SENSORS[sensor_name], rng)
    work = Work(signatures(plan, sensor_name), factors, device)
    colour = np.array(COLOURS[rng.integers(len(COLOURS))]) if kind == "coloured" else None
    faults = _effects(kind, work, rng)
    columns = simulate(work, faults, False, rng, colour)
    name = f"case-{number:05d}"
    said = {0: "none", 1: "single"}.get(len(faults), "several")
    label = {**label_of(name, said, faults, work, False), "variety": kind}
    case = Case(name, plan, sensor_name, columns, label, tuple(faults), device)
    return _mislabelled(case, rng) if kind == "mislabelled" else case


def _effects(kind: str, work: Work, rng: np.random.Generator) -> list[Fault]:
    energy = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    match kind:
        case "triple":
            return effects_apart(work, 3, rng, WEAKEST_OF_THREE)
        case "step":
            return [one_effect(work, ["gyro_bias_step", "accel_bias_step"], energy, rng)]
        case "counts":
            size = float(np.exp(rng.uniform(*np.log(COARSE))))
            return [Fault("gyro_quantization", np.array([size * work.sigma[0]]))]
        case "late":
            return [one_effect(work, ["gyro_bandwidth", "time_latency"], energy, rng)]
        case "coloured":
            names = [name for name in CATALOGUE if not KINDS[name].covariance and name != "table_rate_error"]
            names.remove("gyro_bias_random_walk")
            return [one_effect(work, names, energy, rng)] if rng.random() < 0.5 else []
    return []


def _mislabelled(case: Case, rng: np.random.Generator) -> Case:
    """The recording with one mistake in what is declared of its channels."""
    names = channel_names(SENSORS[case.sensor])
    triad = names[:3] if rng.random() < 0.5 else names[3:]
    first, second = rng.permutation(3)[:2]
    columns: dict[str, Array] = dict(case.columns)
    what = str(rng.choice(["axis_reversed", "axes_exchanged", "unit_wrong"]))
    if what == "axis_reversed":
        columns[triad[first]] = -columns[triad[first]]
    elif what == "axes_exchanged":
        columns[triad[first]], columns[triad[second]] = columns[triad[second]], columns[triad[first]]
    else:
        columns[triad[first]] = columns[triad[first]] / (57.29577951308232 if triad[0].startswith("gyro") else 9.80665)
    share = [float(name in (triad[first], triad[second])) for name in names]
    entry = {
        "effect": what,
        "theta": [],
        "shape": [],
        "lambda": STRONGEST,
        "kept_share": None,
        "absorbed": False,
        "class": [what],
        "channels": share,
    }
    return replace(
        case, columns=columns, label={**case.label, "kind": "mislabelled", "effects": [what], "entries": [entry]}
    )
