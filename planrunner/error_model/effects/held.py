"""Effects that make samples stick: the outputs repeat their last value for some time."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, WithoutColumns


class SamplesStuck(WithoutColumns):
    """From a given time since power-on, the outputs keep the value of one sample, including its noise, for some time."""

    id, outside, shape_name, shape_unit = "samples_stuck", "stuck", "time", "s"
    about = About(
        "samples repeat the last value",
        "For some time the outputs keep the value of one sample, because the sensor or the logger gives no new sample.",
        Actor.BENCH,
        "Look for lost messages, an overloaded logger or a converter that stopped at this time, and leave these samples out: {found}.",
    )


def sticking(time: Array, values: Array, begin: float, lasting: float, before: float) -> Array:
    """Returns the values of an output in which samples are stuck, shape (n,). From the time `begin` on, for `lasting` seconds, the
    values repeat the last value before `begin`. `before`: the value before the first of `values`."""
    inside = np.flatnonzero((time >= begin) & (time < begin + lasting))
    if not len(inside):
        return values
    out = values.copy()
    out[inside] = values[inside[0] - 1] if inside[0] > 0 else before
    return out
