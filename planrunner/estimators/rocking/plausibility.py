"""Warnings about implausible drifts of single runs. A reversed channel causes such drifts, but it hardly changes the differences
between runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.estimators.rocking.statistics import AXES, StateDrifts
from planrunner.observation.observations import SIGNIFICANCE


def implausible(states: Sequence[StateDrifts], earth_rate: float, stated: float) -> Iterator[Said]:
    """Warnings about runs whose drift equals the Earth's rate, or differs between the two methods.

    earth_rate: deg/h. stated: standard uncertainty [deg/h] of the difference between the methods that the declared errors of the rings
    cause.
    """
    tests = sum(2 * len(state.level) for state in states)
    for state in states:
        for dynamic, drifts in zip((False, True), state.runs, strict=True):
            for place, axis in enumerate(state.level):
                runs = _runs(dynamic, state.name, AXES[axis])
                mean = float(np.mean(drifts[:, place]))
                if abs(mean) > earth_rate / 2:
                    yield said(
                        "{runs}: the drift by accelerometers is {drift:.3g} deg/h, more than half the Earth rate. A reversed "
                        "accelerometer causes such a drift: check the signs of the accelerometers and the orientation.",
                        runs=runs,
                        drift=mean,
                    )
                elif drifts.shape[1] > 2:
                    difference = drifts[:, place + 2] - drifts[:, place]
                    if _differs(difference, stated, SIGNIFICANCE / tests):
                        yield said(
                            "{runs}: the drifts by gimbal angles and by accelerometers differ by {difference:.3g} deg/h, more than "
                            "their scatter and the position uncertainty of the table explain: check the signs of the "
                            "accelerometers, gimbals and rings, and `gimbal_axes`.",
                            runs=runs,
                            difference=float(np.mean(difference)),
                        )


def _runs(dynamic: bool, state: str, axis: str) -> Said:
    if dynamic:
        return said("dynamic runs, {state}, {axis}", state=state, axis=axis)
    return said("static runs, {state}, {axis}", state=state, axis=axis)


def _differs(difference: Array, stated: float, level: float) -> bool:
    """Student's t-test of a mean (n,) against zero."""
    from scipy.special import stdtrit

    count = len(difference)
    spread = math.hypot(float(np.std(difference, ddof=1)) / math.sqrt(count), stated)
    return abs(float(np.mean(difference))) > float(stdtrit(count - 1, 1 - level / 2)) * spread
