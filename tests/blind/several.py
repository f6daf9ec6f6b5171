"""Recordings in which three effects act: generated, diagnosed and scored. They share no code with the diagnosis.

    python -m tests.blind.several CASES --seed SEED [--first NUMBER] [--json FILE]

Every effect has a strength λ between `WEAKEST` and `STRONGEST`, log-uniform, and none of the three reproduces more than half of another.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.blind import folder
from tests.blind.device import SENSORS
from tests.blind.generator import Case, Work, effects_apart, label_of, signatures, simulate, stream, surroundings
from tests.blind.scoring import Rate

WEAKEST, STRONGEST = 200.0, 1e4
PLANS = ("rocking", "thermal", "rich")
"""Plans that excite enough effects."""
SURE = 0.99
Shut = tuple[float, float, float, float]


def case_of(seed: int, number: int, count: int = 3) -> Case:
    """Case `number`, with `count` effects."""
    rng = stream(seed, number, 0)
    plan, sensor_name = PLANS[rng.integers(len(PLANS))], list(SENSORS)[rng.integers(len(SENSORS))]
    draw = stream(seed, number, 1)
    factors, device = surroundings(SENSORS[sensor_name], draw)
    work = Work(signatures(plan, sensor_name), factors, device)
    faults = effects_apart(work, count, draw, WEAKEST)
    columns = simulate(work, faults, False, draw)
    name = f"several-{number:05d}"
    label = label_of(name, "several", faults, work, False)
    return Case(name, plan, sensor_name, columns, label, tuple(faults), device)


@dataclass(frozen=True, slots=True)
class Answered:
    """One answer beside the truth. named: effects of the verdict. right: every named effect is a true one or of its class; all: every
    true effect is named, by class. open: the answer says that something is left. probability: of the verdict; in_set: the 95 % set
    holds the truth, by class, if that is a set of the catalogue. closures: stated, ends of the
    interval, and the true share, of all channels under '' and by channel."""

    case: str
    plan: str
    truth: tuple[str, ...]
    energies: tuple[float, ...]
    verdict: str
    named: tuple[str, ...]
    right: bool
    all: bool
    open: bool
    probability: float
    in_set: bool
    closures: Mapping[str, Shut]
    seconds: float

    @property
    def honest(self) -> bool:
        """All effects named, or the named ones right and the rest reported."""
        return self.right and (self.all or self.open)


def answered(case: Case, seed: int, here: Path) -> Answered:
    """The answer of planrunner to one case."""
    from tests.blind.product import closures_of, diagnosis_of

    folder.write_case(here, case, seed)
    began = time.perf_counter()
    found = diagnosis_of(folder.shown(here, case.name))
    seconds = time.perf_counter() - began
    plain = found.to_json()
    said, rest = plain["verdict"], plain["rest"]
    classes = [set(entry["class"]) for entry in case.label["entries"]]
    named = tuple(said["effects"])
    residue = said["form_residue"]
    left = residue is not None or said.get("something_else", False) or (rest is not None and not rest["passes"])
    sets = [name.split("+") for name in plain["ambiguity_set"]]
    options = [option.split("+") for option in said["class"]] or [list(named)]
    mass = sum(plain["posterior"].get(key, 0.0) for key in _keys(options, residue))
    return Answered(
        case.name,
        case.plan,
        tuple(case.label["effects"]),
        tuple(entry["lambda"] for entry in case.label["entries"]),
        str(said["kind"]),
        named,
        any(_among(option, classes) for option in options),
        any(_among(option, classes) and len(option) == len(classes) for option in options),
        left or said["kind"] in ("none", "unknown"),
        float(mass),
        any(
            _among([n for n in one if n != "unknown"], classes) and (len(one) == 3 or "unknown" in one) for one in sets
        ),
        closures_of(found, case),
        seconds,
    )


def _keys(options: Sequence[Sequence[str]], residue: str | None) -> set[str]:
    more = [()] if residue is None else [(), (residue,)]
    return {"+".join(sorted({*option, *extra})) for option in options for extra in (*more, ("unknown",))}


def _among(names: Sequence[str], classes: Sequence[set[str]]) -> bool:
    """Whether the names belong to different true effects, by class."""
    free = list(classes)
    for name in names:
        at = next((k for k, members in enumerate(free) if name in members), None)
        if at is None:
            return False
        free.pop(at)
    return bool(names)


def answers(cases: int, seed: int, first: int = 0, count: int = 3) -> Iterator[Answered]:
    """Cases generated, diagnosed and compared, one after the other."""
    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        folder.write_setups(here)
        for number in range(first, first + cases):
            yield answered(case_of(seed, number, count), seed, here)


def score(found: Sequence[Answered]) -> dict[str, object]:
    """Shares with Wilson intervals, as [number, of, low, high]."""
    sure = [one for one in found if one.probability >= SURE and one.named]
    shut = [one.closures[""] for one in found if "" in one.closures]
    apart = [value for one in found for name, value in one.closures.items() if name]

    def share(hits: Sequence[bool]) -> list[float]:
        return [sum(hits), len(hits), *(round(v, 3) for v in Rate(sum(hits), len(hits)).interval)] if hits else [0, 0]

    return {
        "all three named": share([one.all for one in found]),
        "all named, or the named ones right and the rest reported": share([one.honest for one in found]),
        "named effects right where P >= .99": share([one.right for one in sure]),
        "95 % set holds the truth": share([one.in_set for one in found]),
        "90 % interval of the closure holds the true share": share([_holds(one) for one in shut]),
        "the same by channel": share([_holds(one) for one in apart]),
        "largest error of the closure": max((abs(one[0] - one[3]) for one in shut), default=None),
        "median seconds": float(np.median([one.seconds for one in found])) if found else None,
    }


def _holds(shut: Shut) -> bool:
    return shut[1] <= shut[3] <= shut[2]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", type=int)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(arguments)
    found = []
    for one in answers(args.cases, args.seed, args.first):
        found.append(one)
        print(json.dumps(asdict(one)), flush=True)
    made = score(found)
    print(json.dumps(made, indent=1))
    if args.json is not None:
        args.json.write_text(json.dumps({"score": made, "cases": [asdict(one) for one in found]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
