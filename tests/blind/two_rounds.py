"""Two rounds: what a diagnosis leaves open is measured again, as it proposes and, for comparison, by repeating the plan.

The second round is made by the same generator with the same device, effect and noise levels; the product sees both rounds as one
recording. `python -m tests.blind.two_rounds COUNT --seed SEED` prints what each case came to and a summary; with `--equipped`
proposals may ask for whatever a three-axis table and a chamber can do, without it for no more than the recording shows.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from planrunner.base.workers import ALONE, Workers, results_in_order
from planrunner.cli.arguments import add_workers, workers_of
from tests.blind import product
from tests.blind.device import SENSORS, Device, Sensor, clean_output, limit, random_device
from tests.blind.effects import CATALOGUE
from tests.blind.folder import declared
from tests.blind.generator import Work, one_effect, signatures, simulate
from tests.blind.motion import Array, Fault, Schedule, Site
from tests.blind.plans import PLANS, Segment

ENOUGH = 0.95
REPEATS = (1, 2, 4)
MOVE, SOAK, LATER = 15.0, 1800.0, 60.0  # s: before a segment, after a change of temperature, before a plan is repeated
SETUPS = (
    ("poor", "mems"),
    ("rates", "mems"),
    ("tumble", "mems"),
    ("poor", "fog"),
    ("rates", "fog"),
    ("rocking", "mems"),
)
WEAKEST, STRONGEST = 9.0, 400.0  # λ: weaker is not seen at all, stronger is mostly settled


@dataclass(frozen=True)
class Outcome:
    """One case. first, proposed, repeated: probability of all hypotheses that hold the true effect, after the first round, and when it is
    first enough in the proposed plan and in repeating, with the hours of test time until then. expected, planned_hours: what the
    proposal promised, and its whole time."""

    case: str
    plan: str
    sensor: str
    effect: str
    energy: float
    first: float
    rivals: tuple[str, ...]
    expected: float
    planned_hours: float
    proposed: float
    proposed_hours: float
    repeated: float
    repeated_hours: float


@dataclass(frozen=True)
class Given:
    """A first round: one effect of the catalogue on a device, of a strength that leaves questions open."""

    sensor: Sensor
    rows: tuple[Segment, ...]
    device: Device
    fault: Fault
    energy: float
    columns: dict[str, Array]


def given(seed: int, number: int, plan: str, sensor_name: str) -> Given:
    """Case `number`: λ log-uniform between `WEAKEST` and `STRONGEST`, noise as declared, no outliers."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 3)))
    around, sensor = signatures(plan, sensor_name), SENSORS[sensor_name]
    work = Work(around, (1.0,) * len(sensor.triads), random_device(sensor, rng))
    energy = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    names = [name for name, kind in CATALOGUE.items() if name != "table_rate_error" and not kind.covariance]
    fault = one_effect(work, names, energy, rng)
    columns = simulate(work, [fault], False, rng)
    return Given(sensor, PLANS[plan], work.device, fault, energy, columns)


def outcome(seed: int, number: int, equipped: bool = False) -> Outcome | str:
    """What the two rounds bring in a case with one effect; why not, where there is nothing to bring. equipped: on a bench with a table and
    a chamber, where the second round begins with the chamber gone back and soaked; not on one of which nothing is known but the recording,
    and which goes on where that ended."""
    plan, sensor_name = SETUPS[number % len(SETUPS)]
    case = given(seed, number, plan, sensor_name)
    true = case.fault.effect
    found, further = product.posterior_and_next(_shown(case.sensor, case.rows, case.columns), MOVE, SOAK, equipped)
    known = _probability(found, true)
    if known >= ENOUGH:
        return "settled"
    if further is None:
        return "nothing proposed"
    if true not in "+".join(further.rivals).split("+"):
        return "true effect not among the rivals"
    if not further.rows:
        return "nothing separates them"
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 4)))
    begin = case.rows[-1].end + (SOAK if equipped else 0.0)
    proposed = _reached(case, further.rows, _parts(len(further.rows)), begin, true, rng)
    repeated = _reached(case, *_repeats(case.rows, equipped), begin, true, rng)
    return Outcome(
        f"case-{number:05d}", plan, sensor_name, true, case.energy, known, further.rivals, further.promised,
        _hours(begin, further.rows), *proposed, *repeated,
    )  # fmt: skip


def _probability(found: Mapping[str, float], true: str) -> float:
    return sum(p for name, p in found.items() if true in name.split("+"))


def _shown(sensor: Sensor, rows: Sequence[Segment], columns: dict[str, Any]) -> Any:
    return SimpleNamespace(sensor=sensor, segments=tuple(rows), columns=columns, bench=declared(sensor, Site()))


def _parts(count: int) -> list[int]:
    """Numbers of segments after which is looked whether the true effect is known: sixths of all."""
    return sorted({max(1, round(count * part / 6)) for part in range(1, 7)})


def _repeats(rows: Sequence[Segment], afresh: bool) -> tuple[list[Segment], list[int]]:
    """The plan again and again, and after how many segments is looked: sixths of the first time, then whole times. afresh: the first time
    at once at a chamber that has gone back and soaked."""
    further: list[Segment] = []
    pause = LATER if rows[-1].chamber == rows[0].chamber else SOAK
    for k in range(REPEATS[-1]):
        begin = (further or rows)[-1].end + (SOAK + MOVE if afresh and not k else pause) - rows[0].start
        further += [replace(row, label=f"{row.label}r{k}", start=row.start + begin) for row in rows]
    return further, [*_parts(len(rows)), *(len(rows) * times for times in REPEATS[1:])]


def _reached(
    case: Given, further: Sequence[Segment], looks: Sequence[int], begin: float, true: str, rng: np.random.Generator
) -> tuple[float, float]:
    """Probability of the true effect, and hours since `begin`, when it is first enough; at the end where it never is."""
    sensor = case.sensor
    whole, first = Schedule((*case.rows, *further), sensor.sampling), Schedule(case.rows, sensor.sampling)
    fault = _kept(case.fault, first, whole, sensor, case.device, rng)
    around = SimpleNamespace(schedule=whole, sensor=sensor)
    work: Any = SimpleNamespace(around=around, device=case.device, factors=(1.0,) * len(sensor.triads))
    columns = simulate(work, [fault], False, rng)
    seam = len(first.time)
    for count in looks:
        rows = whole.segments[: len(case.rows) + count]
        stop = int(np.searchsorted(whole.index, len(rows)))
        both = {name: np.concatenate([case.columns[name], column[seam:stop]]) for name, column in columns.items()}
        reached = _probability(product.posterior(_shown(sensor, rows, both)), true)
        if reached >= ENOUGH:
            break
    return reached, _hours(begin, further[:count])


def _kept(
    fault: Fault, first: Schedule, whole: Schedule, sensor: Sensor, device: Device, rng: np.random.Generator
) -> Fault:
    """The effect as the same device has it under the longer schedule: new orientations get errors of their own, a limit stays."""
    if fault.effect == "table_position_error":
        size = float(np.std(fault.theta))
        more = size * rng.standard_normal(3 * (len(whole.places) - len(first.places)))
        return replace(fault, theta=np.concatenate([fault.theta, more]))
    if fault.effect == "gyro_saturation":
        stop = limit(clean_output(first, sensor, device, {})[:, :3], float(fault.theta[0]))
        depth = limit(clean_output(whole, sensor, device, {})[:, :3], 0.0) - stop
        return replace(fault, theta=np.array([depth]))
    return fault


def _hours(begin: float, further: Sequence[Segment]) -> float:
    return (further[-1].end - begin) / 3600


def outcomes(
    seed: int, numbers: Sequence[int], workers: Workers = ALONE, equipped: bool = False
) -> Iterator[tuple[int, Outcome | str]]:
    """All cases, those of one set-up together: its signatures are kept."""
    numbers = sorted(numbers, key=lambda number: (number % len(SETUPS), number))
    work = partial(_numbered, seed, equipped)
    yield from results_in_order(work, numbers, workers)


def _numbered(seed: int, equipped: bool, number: int) -> tuple[int, Outcome | str]:
    return number, outcome(seed, number, equipped)


def summary(found: Sequence[Outcome]) -> dict[str, float]:
    """Figures over the cases that were left open and that a proposal was made for. ratio: of the hours that the proposals took to those
    that repeating took, where the proposals were enough; repeating that was not enough counts with the hours that were tried."""
    if not found:
        return {"cases": 0}
    enough = [one for one in found if one.proposed >= ENOUGH]
    ratios = [one.proposed_hours / one.repeated_hours for one in enough]
    return {
        "cases": len(found),
        "first": float(np.mean([one.first for one in found])),
        "proposed": float(np.mean([one.proposed for one in found])),
        "promised": float(np.mean([one.expected for one in found])),
        "repeated": float(np.mean([one.repeated for one in found])),
        "proposed_enough": len(enough) / len(found),
        "repeated_enough": sum(one.repeated >= ENOUGH for one in found) / len(found),
        "both_enough": sum(min(one.proposed, one.repeated) >= ENOUGH for one in found) / len(found),
        "proposed_hours_median": float(np.median([one.proposed_hours for one in found])),
        "repeated_hours_median": float(np.median([one.repeated_hours for one in found])),
        "ratio_median": float(np.median(ratios)) if ratios else float("nan"),
        "ratio_at_most_a_fifth": float(np.mean([ratio <= 0.2 for ratio in ratios])) if ratios else float("nan"),
    }


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.two_rounds", description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, required=True)
    add_workers(parser, "processes of this machine (default: 1)")
    parser.add_argument("--equipped", action="store_true", help="on a bench with a three-axis table and a chamber")
    given = parser.parse_args(argv)
    found, others = [], dict[str, int]()
    for done, (_, one) in enumerate(outcomes(given.seed, range(given.count), workers_of(given), given.equipped), 1):
        if isinstance(one, Outcome):
            found.append(one)
            print(json.dumps(asdict(one)), flush=True)
        else:
            others[one] = others.get(one, 0) + 1
        print(f"{done} of {given.count}", file=sys.stderr, flush=True)
    print(json.dumps({**summary(found), "left_out": others}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
