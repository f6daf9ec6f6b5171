"""Finds delays between the outputs of a sensor and the recorded channels that show its motion.

The outputs y of the gyros are compared with the recorded rates ω of an earlier time, y(t) = b + M·ω(t − d), with a free bias b and
a free matrix M. The delay d of a segment is the delay with the smallest sum of squared residuals. A delay that is the same in all
segments has its cause in the clocks or filters of the two devices. A delay that changes from one segment to the next shows lost
samples, or clocks that run at different rates.

A small delay is not corrected here, because the diagnosis removes the response to this delay from the samples (decision 83). The
response is proportional to the angular acceleration only if the delay is much shorter than the changes of the motion. Therefore,
large delays are corrected before the diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.recording_checks import STIRRED
from planrunner.gap.hypotheses.declarations import WrongDeclaration, corrected

LATE = 0.02
"""Smallest delay that is corrected, s. It must also be at least `PERIODS` sampling periods."""
PERIODS = 2.0
LONGEST = 2.0
"""Longest delay that the search considers, s. The search also considers no delay longer than a quarter of the segment."""
FINEST = 0.005
"""Smallest step of the search, s."""
HALVED = 0.5
"""A delay counts only if it reduces the sum of the squared residuals to at most this fraction."""
ALIKE = 0.1
"""Several delays may explain the data almost equally well, for example in a periodic motion. If the sums of squared residuals of
such delays differ by at most this fraction of the explained part, the shortest delay is chosen."""
SURE = 5.0
"""A delay, or a change of the delay, must exceed its standard uncertainty by this factor."""
_ROUNDS = 3  # largest number of corrections; each correction measures the remaining delay
FEWEST = 30
"""Smallest number of samples with which the delay of a segment is measured."""


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of the outputs in one segment, and its standard uncertainty, both in s. A negative delay means that the channels that show
    the motion are late."""

    seconds: float
    uncertainty: float


def in_step(
    observed: Observed, read: Callable[[Mapping[str, float]], Observed], period: float
) -> tuple[Observed, list[WrongDeclaration]]:
    """Corrects large delays between the outputs and the recorded motion. Returns the corrected recording, and the delay as a wrong
    declaration. The recording is unchanged if there is no large delay.

    `read`: function that reads the recording again and shifts the outputs by given delays. Its argument maps the label of each
    segment to the delay [s]. `period`: sampling period of the recording, s.
    """
    least = max(LATE, PERIODS * period)
    if not observed.moved.any():
        return observed, []
    found = delays(corrected(observed)[0], least)
    if not any(abs(one.seconds) >= max(least, SURE * one.uncertainty) for one in found.values()):
        return observed, []
    total = dict.fromkeys(found, 0.0)
    steps = {label: period * float(size) for label, size in zip(observed.labels, observed.bin_size, strict=True)}
    for _ in range(_ROUNDS):
        # The outputs are shifted by whole samples. The remaining delay is measured again and must not count twice.
        total = {
            label: steps[label] * round((late + found[label].seconds) / steps[label])
            for label, late in total.items()
            if label in found
        }
        known = _carried(observed, total)
        seen = read(known)
        found = delays(corrected(seen)[0], least)
        if not found:  # the shifted outputs do not follow the motion
            return observed, []
        if set(found) < set(total) or all(abs(one.seconds) < steps[label] for label, one in found.items()):
            break
    u = max(one.uncertainty for one in found.values())
    whole = {label: Delay(late + (found[label].seconds if label in found else 0.0), u) for label, late in total.items()}
    return seen, [_declared(observed, whole, max(steps.values()))]


def _carried(observed: Observed, known: Mapping[str, float]) -> dict[str, float]:
    """Returns the delays [s] of all segments with a recorded motion, by label. `known`: the delays [s] of the segments that show
    their delay, by label. A segment that does not show its delay gets the delay of the segment before it; the first segments get
    the delay of the first segment that shows it."""
    late, found = next(iter(known.values())), {}
    for label, moved in zip(observed.labels, observed.moved, strict=True):
        if moved:
            late = found[label] = known.get(label, late)
    return found


def _declared(observed: Observed, whole: Mapping[str, Delay], step: float) -> WrongDeclaration:
    """Describes delays as a wrong declaration. If the outputs become earlier at the start of a segment, the declaration describes
    lost samples; otherwise, it describes a delay. The outputs are shifted by whole samples, so the standard uncertainty is at least
    that of a rounding to whole samples. `whole`: the delay of each segment, by label. `step`: longest interval between samples (or
    bins), s."""
    labels, values = list(whole), np.array([one.seconds for one in whole.values()])
    u = float(np.hypot(max(one.uncertainty for one in whole.values()), step / np.sqrt(12)))
    if np.ptp(values) <= max(LATE, SURE * u):
        late = float(np.median(values))
        size = f"{abs(late) * 1e3:.4g} ± {u * 1e3:.2g} ms"
        message = f"the outputs follow the recorded motion {size} {'late' if late > 0 else 'early'}"
        if late < 0:
            return WrongDeclaration("reference_latency", {"delay": -late}, message, size)
        filtered = "a low-pass filter of the sensor, which delays slow motions in the same way"
        return WrongDeclaration("time_latency", {"delay": late}, message, size, filtered)
    at = int(np.argmax(np.abs(np.diff(values))))
    before, after = float(np.median(values[: at + 1])), float(np.median(values[at + 1 :]))
    size = f"{abs(after - before) * 1e3:.4g} ± {u * np.sqrt(2) * 1e3:.2g} ms"
    way = "later" if after > before else "earlier"
    message = f"from '{labels[at + 1]}' on, the outputs follow the recorded motion {size} {way} than before"
    end = float(observed.time[observed.bounds[observed.labels.index(labels[at]) + 1] - 1])
    if after > before:
        hint = f"{size} of the channels that show the motion were lost after {end:.5g} s, or their clock is slower"
        return WrongDeclaration("reference_latency", {"delay": before - after}, message, hint)
    return WrongDeclaration(
        "samples_dropped", {"time": end, "lost": (before - after) * 1e3}, message, f"{size} were lost after {end:.5g} s"
    )


def delays(observed: Observed, least: float) -> dict[str, Delay]:
    """Measures the delays of the segments with a recorded motion. Returns them by label; segments whose motion does not show the
    delay are left out. Successive segments get the same delay, unless the delay changes clearly and by more than `least` [s]."""
    each: dict[str, Delay] = {}
    for label, rows, moved in zip(observed.labels, observed.segments(), observed.moved, strict=True):
        own = _of_segment(observed, rows) if moved else None
        if own is not None:
            each[label] = own
    return _in_groups(each, least) if each else {}


def _in_groups(each: Mapping[str, Delay], least: float) -> dict[str, Delay]:
    """Divides successive segments into groups. Between the groups, the delay changes clearly and by more than `least` [s]. Returns,
    for each segment, the median of the delays in its group. The delays of a group may differ by more than `least` and by more than
    their uncertainties explain, for example if there are few segments, or if the clocks run at different rates. Each segment of
    such a group keeps its own delay."""
    labels, values = list(each), np.array([one.seconds for one in each.values()])
    steps = np.abs(np.diff(values))
    typical = 1.4826 * float(np.median(steps)) / np.sqrt(2) if len(steps) else 0.0
    scatter = max(typical, min(one.uncertainty for one in each.values()))
    edges = [0, *(np.flatnonzero(steps > max(least, SURE * np.sqrt(2) * scatter)) + 1).tolist(), len(values)]
    found: dict[str, Delay] = {}
    for begin, end in pairwise(edges):
        own = {label: each[label] for label in labels[begin:end]}
        worst = max(one.uncertainty for one in own.values())
        if np.ptp(values[begin:end]) > max(least, SURE * np.sqrt(2) * worst):
            found |= own
            continue
        one = Delay(float(np.median(values[begin:end])), scatter * float(np.sqrt(np.pi / 2 / (end - begin))))
        found |= dict.fromkeys(labels[begin:end], one)
    return found


def _of_segment(observed: Observed, rows: slice) -> Delay | None:
    """Measures the delay of one segment; None if its motion does not show the delay. A search over all delays with `_unexplained`
    finds the region of the best delay. In this region, the delay is found from the residuals of the samples. `rows`: the samples of
    the segment."""
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    channels = observed.of_kind("gyro")
    time, rates = observed.time[rows], observed.omega[rows]
    if not channels or len(time) < FEWEST:
        return None
    longest = min(LONGEST, float(np.ptp(time)) / 4)
    inside = (time > time[0] + longest) & (time < time[-1] - longest)
    centred = rates - rates.mean(axis=0)
    _, size, directions = np.linalg.svd(centred, full_matrices=False)
    seen = directions[size / np.sqrt(len(time)) > STIRRED["gyro"]]
    axes = [observed.channels[index].axis for index in channels]
    told = [place for place, axis in enumerate(axes) if len(seen) and np.linalg.norm(seen[:, axis]) > np.sqrt(0.5)]
    if not told or np.count_nonzero(inside) < FEWEST:
        return None
    values = observed.values[rows][inside][:, [channels[place] for place in told]]
    values = values - values.mean(axis=0)
    energy = np.maximum((values**2).sum(axis=0), 1e-300)
    course, own = CubicSpline(time, rates @ seen.T), seen[:, [axes[place] for place in told]]

    def residual(delay: float) -> float:
        """Returns the fraction of an output's energy that the rates of `delay` seconds earlier do not explain, averaged over the
        outputs. The fraction counts as 1 for an output that follows the rates with the wrong sign."""
        earlier = course(time[inside] - delay)
        gains, *_ = np.linalg.lstsq(earlier - earlier.mean(axis=0), values, rcond=None)
        left = values - (earlier - earlier.mean(axis=0)) @ gains
        right = (gains * own).sum(axis=0) > 0
        return float(np.where(right, (left**2).sum(axis=0) / energy, 1.0).mean())

    step = max(FINEST, float(np.median(np.diff(time))) / 40)
    each = CubicSpline(time, observed.values[rows][:, [channels[place] for place in told]])
    uniform = np.arange(time[0], time[-1], step)
    steps = int(longest / step)
    tried = step * np.arange(-steps, steps + 1)
    shares = _unexplained(course(uniform), each(uniform), own, steps)
    without = residual(0.0)
    good = np.flatnonzero(shares <= shares.min() + ALIKE * max(without - shares.min(), 0.0))
    near = good[np.argmin(np.abs(tried[good]))]
    for way in (-1, 1):  # goes on to the local minimum
        while 0 < near < len(tried) - 1 and shares[near + way] < shares[near]:
            near += way
    bottom = minimize_scalar(
        residual, bounds=(tried[near] - step, tried[near] + step), method="bounded", options={"xatol": 1e-6}
    )
    delay, share = float(bottom.x), float(bottom.fun)
    bend = (residual(delay + step) - 2 * share + residual(delay - step)) / step**2
    if share > HALVED**2 or bend <= 0 or abs(delay) > longest - step:
        return None
    if abs(delay) >= LATE and share > HALVED * without:
        return None
    count = np.count_nonzero(inside) * len(told)
    uncertainty = float(np.sqrt(2 * share / count / bend))
    return Delay(delay, uncertainty) if uncertainty < longest else None


def _unexplained(rates: Array, outputs: Array, axes: Array, steps: int) -> Array:
    """Returns, for delays of −`steps` to `steps` samples, the fraction of an output's energy that the rates do not explain, shape (2 ·
    steps + 1,). The fraction is averaged over the outputs; it counts as 1 for an output that follows the rates with the wrong sign.

    `rates`: array of shape (n, r), at uniform times. `outputs`: array of shape (n, p), at the same times. `axes`: array of shape
    (r, p), the rates about the axis of each output for a rate of 1. The products of the outputs and the earlier rates are computed
    for all delays at once, as a correlation by FFT.
    """
    from scipy.signal import correlate

    inside = outputs[steps : len(outputs) - steps]
    inside = inside - inside.mean(axis=0)
    energy = np.maximum((inside**2).sum(axis=0), 1e-300)
    first, count = np.arange(2 * steps, -1, -1), len(inside)

    def windowed(values: Array) -> Array:
        """Returns the sum of values (n, …) over the window of each delay, shape (2 · steps + 1, …). The window contains the samples
        of the rates that this delay assigns to the outputs."""
        total = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0)
        return np.asarray(total[first + count] - total[first])

    sums = windowed(rates)
    gram = windowed(rates[:, :, None] * rates[:, None]) - sums[:, :, None] * sums[:, None] / count
    cross = np.array([[correlate(rate, output, "valid", "fft")[first] for output in inside.T] for rate in rates.T])
    cross = np.moveaxis(cross, 2, 0)  # (delays, r, p)
    gains = np.linalg.pinv(gram, hermitian=True) @ cross
    left = 1 - (gains * cross).sum(axis=1) / energy
    return np.asarray(np.where((gains * axes).sum(axis=1) > 0, left, 1.0).mean(axis=1))
