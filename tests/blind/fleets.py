"""Fleets with known causes: `python -m tests.blind.fleets COUNT --seed SEED`.

Draws the number of benches and devices, which sources contribute to an amplitude (bench, device, occasion, what all runs have in common),
and how much; then the estimate of every run with its noise. Prints how often an attribution with a probability of 95 % or more is right,
and how often the interval of a part contains the true part. The generator shares no code with the attribution, and draws its sizes from a
law of its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.product import attributed

SURE = 0.95
_CHANCE = 0.4  # that a source contributes
_SIZES = (1.0, 100.0)  # standard deviation of its parts, in units of the typical noise of a run: log-uniform


@dataclass(frozen=True)
class DrawnFleet:
    """values, noise: (n,). of: the number of the bench, device and occasion of every run (n,). parts: the true part of each, all zero
    where the source does not contribute."""

    values: NDArray[np.float64]
    noise: NDArray[np.float64]
    of: dict[str, NDArray[np.int64]]
    parts: dict[str, NDArray[np.float64]]


@dataclass
class Score:
    """sure: attributions with a probability of 95 % or more, for or against a source; right: those that are true. parts: the parts of
    named sources; covered: those within their intervals."""

    fleets: int = 0
    sure: int = 0
    right: int = 0
    named: int = 0
    named_right: int = 0
    parts: int = 0
    covered: int = 0


def draw(random: np.random.Generator) -> DrawnFleet:
    """A crossed design (every device on several benches) or a nested one (every device on one bench), with one to four runs each."""
    benches, devices = int(random.integers(1, 6)), int(random.integers(1, 9))
    crossed, rows = bool(random.integers(2)), []
    for device in range(devices):
        visited = random.permutation(benches)[: int(random.integers(1, benches + 1)) if crossed else 1]
        rows += [(int(bench), device) for bench in visited for _ in range(int(random.integers(1, 5)))]
    if len(rows) < 2:
        rows *= 2
    of = {
        "bench": np.array([bench for bench, _ in rows]),
        "device": np.array([device for _, device in rows]),
        "occasion": np.arange(len(rows)),
        "common": np.zeros(len(rows), dtype=np.int64),
    }
    parts = {}
    for source, members in of.items():
        size = np.exp(random.uniform(*np.log(_SIZES))) if random.random() < _CHANCE else 0.0
        parts[source] = random.normal(0.0, 1.0, int(members.max()) + 1) * size
    noise = np.exp(random.normal(0.0, 0.3, len(rows)))
    truth = sum(parts[source][members] for source, members in of.items())
    return DrawnFleet(truth + noise * random.normal(0.0, 1.0, len(rows)), noise, of, parts)


def campaign(count: int, seed: int) -> Score:
    """The score of so many fleets."""
    score = Score()
    for random in _streams(count, seed):
        _add(score, draw(random))
    return score


def _streams(count: int, seed: int) -> Iterator[np.random.Generator]:
    return (np.random.default_rng(one) for one in np.random.SeedSequence(seed).spawn(count))


def _add(score: Score, drawn: DrawnFleet) -> None:
    score.fleets += 1
    for one in attributed(drawn.values, drawn.noise, drawn.of):
        names = [source.value for source in one.component.sources]
        present = any(bool(drawn.parts[name].any()) for name in names)
        if one.probability >= SURE or one.probability <= 1 - SURE:
            score.sure += 1
            score.right += present == (one.probability >= SURE)
        if one.probability < SURE:
            continue
        score.named += 1
        score.named_right += present
        for part, run in zip(one.parts, _first_runs(one.component.members), strict=True):
            true = sum(drawn.parts[name][drawn.of[name][run]] for name in names)
            score.parts += 1
            score.covered += bool(abs(part.part.value - true) <= part.part.expanded)


def _first_runs(members: NDArray[np.int64]) -> NDArray[np.intp]:
    """The first run of every group."""
    return np.unique(members, return_index=True)[1]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.fleets", description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, required=True)
    given = parser.parse_args(argv)
    score = campaign(given.count, given.seed)
    print(f"fleets: {score.fleets}")
    print(f"sure attributions: {score.sure}, right {score.right / score.sure:.4f}")
    print(f"named sources: {score.named}, right {score.named_right / score.named:.4f}")
    print(f"parts of named sources: {score.parts}, within U {score.covered / score.parts:.4f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
