"""Coverage of the intervals of rocking drifts in long campaigns: what the filter leaves in both windows is drawn, not whole records.

python tests/estimators/rocking_window_coverage.py COUNT [SEED]
"""

from __future__ import annotations

import math
import sys

import numpy as np
from rocking_coverage import MICRO_G, REPEATS, ROCKING, tell
from rocking_recordings import ARCSEC, ATTITUDES, DEG, EARTH, GRAVITY, PER_HOUR, planned
from scipy.spatial.transform import Rotation

from planrunner.estimators.rocking.influences import drifts_of
from planrunner.estimators.rocking.runs import Quadruple, find_runs, quadruples
from planrunner.estimators.rocking.solution import ReducedRun, RockingConditions, Window
from planrunner.estimators.rocking.statistics import StateDrifts, combine
from planrunner.uncertainty.decision import coverage_factor

STATES = ("vertical", "horizontal")
MIDDLES = np.array([61.0, 599.0])  # s, of the windows
ROCKED = np.array([61.0, 480.0])  # s of rocking by then
NAMES = ("static-1", "dynamic-1", "dynamic-2", "static-2")
CONDITIONS = RockingConditions(EARTH, GRAVITY, np.zeros(6))
TRUTH = ROCKING / PER_HOUR * (ROCKED[1] - ROCKED[0]) / (MIDDLES[1] - MIDDLES[0])


def plan(state: str) -> tuple[Quadruple, ...]:
    segments = [planned(state, name, 4 * r + k, 600.0) for r in range(REPEATS) for k, name in enumerate(NAMES)]
    return tuple(quadruples(find_runs(segments, "xzy")))


def windows(state: str, dynamic: np.ndarray, draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Specific force and attitude by encoders in both windows of n runs, each (n, 2, 3)."""
    n = len(dynamic)
    drift = (np.array([0.21, -0.34, 0.15]) + 0.002 * draw.standard_normal((n, 1, 3))) * PER_HOUR
    lead = np.where(dynamic, 5.0, 0.0)[:, None]
    angle = drift * (MIDDLES + lead)[:, :, None]
    angle = angle + dynamic[:, None, None] * ROCKING * (ROCKED + lead)[:, :, None]
    steps = 0.0004 * DEG / 60 * np.sqrt(np.diff(MIDDLES, prepend=0.0))[None, :, None] * draw.standard_normal((n, 2, 3))
    angle += np.cumsum(steps, axis=1)
    start = Rotation.from_matrix(ATTITUDES[state].T) * Rotation.from_rotvec(60 * ARCSEC * draw.uniform(-1, 1, (n, 3)))
    force, turn = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    released = Rotation.from_rotvec(-lead * EARTH)
    for k, middle in enumerate(MIDDLES):
        site = Rotation.from_rotvec(middle * EARTH)
        element = released * start * Rotation.from_rotvec(angle[:, k])
        force[:, k] = element.inv().apply(site.apply([0.0, 0.0, GRAVITY]))
        turn[:, k] = (Rotation.from_matrix(ATTITUDES[state]) * site.inv() * element).as_rotvec()
    walk = 10 * MICRO_G / 60 * np.sqrt(np.diff(MIDDLES, prepend=0.0))[None, :, None] * draw.standard_normal((n, 2, 3))
    force += np.cumsum(walk, axis=1) + 5 * MICRO_G / math.sqrt(8.0) * draw.standard_normal((n, 2, 3))
    before, after = 15 * ARCSEC * draw.standard_normal((2, n, 3))
    turn[:, 0] += before
    turn[:, 1] += np.where(dynamic[:, None], after, before)
    return force, turn


def campaign(count: int, seed: int = 1, told_after: int = 0) -> dict[str, tuple[int, int]]:
    """Coefficient → (intervals that hold the truth, intervals)."""
    draw = np.random.default_rng(seed)
    plans = {state: plan(state) for state in STATES}
    held: dict[str, tuple[int, int]] = {}
    for number in range(1, count + 1):
        states = []
        for state, four_by_four in plans.items():
            runs = [run for quadruple in four_by_four for run in quadruple.runs]
            force, turn = windows(state, np.array([run.dynamic for run in runs]), draw)
            made = [
                ReducedRun(run, first, second, before=None, lead=None)
                for i, run in enumerate(runs)
                for first, second in [[Window(MIDDLES[[k]], force[i, [k]], turn[i, [k]]) for k in (0, 1)]]
            ]
            drifts = np.array([drifts_of(run, CONDITIONS) for run in made]).reshape(REPEATS, 4, 4)
            states.append(StateDrifts(state, runs[0].state.level, four_by_four, drifts))
        found = combine(states)
        spread = np.sqrt(np.diag(found.covariance))
        for m, axis in enumerate(found.axes):
            name = ("gimbal_" if found.by_gimbals[m] else "") + f"drift_{'xyz'[axis]}"
            inside = abs(found.values[m] - TRUTH[axis]) <= coverage_factor(found.degrees_of_freedom[m]) * spread[m]
            before = held.get(name, (0, 0))
            held[name] = before[0] + bool(inside), before[1] + 1
        if told_after and number % told_after == 0:
            tell(held)
    return held


if __name__ == "__main__":
    count, *seed = (int(word) for word in sys.argv[1:3])
    campaign(count, seed[0] if seed else 1, told_after=1000)
