"""What a plan says of settling and of limits while recording, in SI units and held against what the bench can measure.

On a simulated clock nothing is measured: a simulated state is steady when its instrument says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from planrunner.base.findings import Mark
from planrunner.bench.model import BenchModels
from planrunner.plan import holding_spec
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Stability, Watch

Add = Callable[[str, Mark, str, str], None]


def wait_of(state: Mapping[str, Any], name: str) -> tuple[float, Stability | None]:
    """Planned seconds of `settle` or `soak`, and what must have settled after it, if the plan says so."""
    stated: Quantity | holding_spec.Stability | None = state.get(name)
    if not isinstance(stated, holding_spec.Stability):
        return (0.0 if stated is None else stated.value), None
    duration = stated.for_.value
    return duration, Stability(_in_si(stated), duration, stated.within.value)


def watch_of(state: Mapping[str, Any]) -> Watch | None:
    stated: holding_spec.Watch | None = state.get("watch")
    if stated is None:
        return None
    lost, corrupt = stated.lost_frames, stated.corrupt_frames
    return Watch(
        _in_si(stated),
        None if lost is None else lost.value,
        None if corrupt is None else corrupt.value,
        stated.doubts == "limit",
        stated.retakes,
    )


def check_measured(state: Mapping[str, Any], marks: Mapping[str, Mark], models: BenchModels, add: Add) -> None:
    """A limit on something that no instrument of the bench can measure is an error; `add` takes code, place, message and hint."""
    for name in ("soak", "settle", "watch"):
        stated = state.get(name)
        if isinstance(stated, holding_spec.Tolerated) and stated.stated() and not models.measures:
            message = f"no instrument of this bench has live readings of {', '.join(stated.stated())}"
            add("physics-unmeasured", marks[name], message, "leave them out, or use a bench that measures them")
    watch = state.get("watch")
    if watch is None or models.counts:
        return
    if watch.lost_frames is not None or watch.corrupt_frames is not None:
        message = "the sensor's driver does not count lost and corrupt frames"
        add("physics-unmeasured", marks["watch"], message, "leave their limits out, or use another driver")


def _in_si(stated: holding_spec.Tolerated) -> dict[str, float]:
    return {name: quantity.value for name, quantity in stated.stated().items()}
