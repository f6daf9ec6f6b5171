"""Recordings of single effects that are easily taken for each other: generated, diagnosed and counted by what was named. They share no code
with the diagnosis.

    python -m tests.blind.confusion GROUP CASES --seed SEED [--first NUMBER] [--json FILE]

Each effect of the group has `CASES` cases, with a strength λ between `WEAKEST` and `STRONGEST`, log-uniform, or with a size of `SIZES`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.blind import folder
from tests.blind.device import SENSORS
from tests.blind.effects import KINDS
from tests.blind.generator import Case, Work, one_effect, signatures, simulate, stream, strength_of, surroundings
from tests.blind.motion import Fault

WEAKEST, STRONGEST = 36.0, 1e4
SURE = 0.99
GROUPS: dict[str, tuple[str, ...]] = {
    "steps": ("gyro_bias_step", "gyro_bias_random_walk"),
    "accelerometer steps": ("accel_bias_step",),
    "late": ("gyro_bandwidth", "time_latency"),
    "counts": ("gyro_quantization",),
    "vibration": ("gyro_vibration_rectification", "accel_vibration_rectification"),
    "limits": ("gyro_saturation_asymmetric", "gyro_soft_saturation", "gyro_saturation", "gyro_scale_nonlinearity"),
    "accelerometer noise": ("accel_noise_excess",),
    "accelerometer counts": ("accel_quantization",),
    "lost samples": ("samples_dropped", "time_latency"),
    "mounting": ("mount_shift",),
    "axes late": ("gyro_axis_delay", "time_latency"),
    "thermal lag": ("gyro_bias_temperature_lagged", "gyro_thermal_gradient"),
    "stuck": ("samples_stuck",),
    "interference": ("gyro_line_interference", "accel_line_interference"),
}
"""Effects that are easily taken for each other."""
SETUPS = {
    "steps": (("tumble", "mems"), ("rocking", "fog"), ("thermal", "fog"), ("rates", "mems")),
    "accelerometer steps": (("tumble", "mems"), ("rates", "mems")),
    "late": (("rocking", "mems"), ("rocking", "fog")),
    "counts": (("tumble", "mems"), ("rates", "mems"), ("rocking", "fog")),
    "vibration": (("rocking", "mems"), ("rich", "mems")),
    "limits": (("rates", "mems"), ("rich", "fog")),
    "accelerometer noise": (("tumble", "mems"), ("rates", "mems")),
    "accelerometer counts": (("tumble", "mems"), ("rates", "mems")),
    "lost samples": (("rocking", "mems"), ("rocking", "fog")),
    "mounting": (("tumble", "mems"), ("rates", "mems"), ("rocking", "mems")),
    "axes late": (("rocking", "mems"), ("rocking", "fog")),
    "thermal lag": (("thermal", "mems"), ("thermal", "fog")),
    "stuck": (("tumble", "mems"), ("rocking", "fog"), ("rates", "mems"), ("thermal", "fog")),
    "interference": (("tumble", "mems"), ("rates", "mems"), ("thermal", "mems")),
}
"""Plans and sensors that show the effects of a group."""

SIZES = {
    "late": (5e-5, 1e-2),
    "counts": (3.0, 30.0),
    "accelerometer noise": (3.0, 9.0),
    "accelerometer counts": (1.5, 30.0),
    "stuck": (0.3, 5.0),
}
"""Size of the effects of a group, log-uniform, where it decides whether they can be distinguished: s, σ of a sample, or the excess of the
noise in units of the noise. Without it, λ is drawn."""
_CHANNEL = {"counts": 0, "accelerometer counts": 3}
"""Groups whose size is in units of σ of a channel."""


def case_of(group: str, seed: int, number: int, effect: str, energy: float | None = None) -> Case:
    """Case `number` of a group, in which this effect acts alone. energy: its λ, by default drawn."""
    setups = SETUPS[group]
    plan, sensor_name = setups[number % len(setups)]
    rng = stream(seed, number, 2 + GROUPS[group].index(effect))
    factors, device = surroundings(SENSORS[sensor_name], rng)
    work = Work(signatures(plan, sensor_name), factors, device)
    size = float(np.exp(rng.uniform(*np.log(SIZES.get(group, (WEAKEST, STRONGEST))))))
    size = size if energy is None else energy
    unit = work.sigma[_CHANNEL[group]] if group in _CHANNEL else 1.0
    kind = KINDS[effect]
    shape = kind.draw(work.around.schedule, rng) if group in SIZES and kind.draw else ()
    fault = Fault(effect, np.array([size * unit]), shape) if group in SIZES else one_effect(work, [effect], size, rng)
    energy = strength_of(work, fault) if group in SIZES else size
    name = f"{effect}-{number:05d}"
    columns = simulate(work, [fault], False, rng)
    entry = {"effect": effect, "theta": fault.theta.tolist(), "shape": list(fault.shape), "lambda": energy}
    label = {"case": name, "kind": "single", "effects": [effect], "entries": [entry]}
    return Case(name, plan, sensor_name, columns, label, (fault,), device)


@dataclass(frozen=True, slots=True)
class Answered:
    """One answer beside the truth. named: effects of the verdict; members: of its class; right: the effect alone is named, or is a member;
    probability: of the verdict; in_set: the 95 % set holds the effect. parameters: name → value and standard uncertainty."""

    case: str
    effect: str
    energy: float
    kind: str
    named: tuple[str, ...]
    members: tuple[str, ...]
    right: bool
    probability: float
    in_set: bool
    theta: tuple[float, ...]
    shape: tuple[float, ...]
    parameters: dict[str, tuple[float, float]]


def answered(case: Case, seed: int, here: Path, effects: Sequence[str] | None = None) -> Answered:
    """The answer of planrunner to one case. `effects`: the hypotheses; None for all."""
    from tests.blind.product import diagnosis_of

    folder.write_case(here, case, seed)
    plain = diagnosis_of(folder.shown(here, case.name), effects).to_json()
    said, (entry,) = plain["verdict"], case.label["entries"]
    named, members = tuple(said["effects"]), tuple(said["class"])
    options = set(members or ["+".join(named) or said["kind"]])
    return Answered(
        case.name,
        entry["effect"],
        float(entry["lambda"]),
        str(said["kind"]),
        named,
        members,
        entry["effect"] in options,
        float(sum(plain["posterior"].get(option, 0.0) for option in options)),
        entry["effect"] in plain["ambiguity_set"],
        tuple(entry["theta"]),
        tuple(entry["shape"]),
        {f"{p['effect']}.{p['name']}": (p["value"], p["standard_uncertainty"]) for p in plain["parameters"]},
    )


def answers(group: str, cases: int, seed: int, first: int = 0) -> Iterator[Answered]:
    """Cases of every effect generated and diagnosed, one set-up after the other."""
    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        folder.write_setups(here)
        several = len(SETUPS[group])
        for number in sorted(range(first, first + cases), key=lambda number: number % several):
            for effect in GROUPS[group]:
                yield answered(case_of(group, seed, number, effect), seed, here)


def score(found: Sequence[Answered]) -> dict[str, object]:
    """What was said of each effect, and how often it was right where it was said with certainty."""
    sure = [one for one in found if one.probability >= SURE and one.kind != "none"]
    return {
        "said": {
            effect: dict(Counter(_said(one) for one in found if one.effect == effect).most_common())
            for effect in dict.fromkeys(one.effect for one in found)
        },
        "right": [sum(one.right for one in found), len(found)],
        "right where P >= .99": [sum(one.right for one in sure), len(sure)],
        "95 % set holds the truth": [sum(one.in_set for one in found), len(found)],
        "mean P of the verdict": float(np.mean([one.probability for one in found])),
    }


def _said(one: Answered) -> str:
    return " or ".join(one.members) or "+".join(one.named) or one.kind


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("group", choices=GROUPS)
    parser.add_argument("cases", type=int)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(arguments)
    found = []
    for one in answers(args.group, args.cases, args.seed, args.first):
        found.append(one)
        print(json.dumps(asdict(one)), flush=True)
    made = score(found)
    print(json.dumps(made, indent=1))
    if args.json is not None:
        args.json.write_text(json.dumps({"score": made, "cases": [asdict(one) for one in found]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
