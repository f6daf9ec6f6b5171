"""What to measure next: segments that the bench can execute and that distinguish the remaining explanations in the shortest time.

The choice is greedy: each step takes the segment with the most expected evidence per second of test time, which includes moves and
temperature changes. The search ends when the expected probability of the true explanation is high enough, or when no segment helps.
A repetition of the recorded segments is evaluated in the same way, for comparison.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.gap.answer.discrimination import Rival, expected_loss, expected_probability
from planrunner.gap.answer.foreseen import Foreseen, following, foresee
from planrunner.gap.answer.other_sensors import ENOUGH, helpful
from planrunner.gap.answer.posterior import Posterior
from planrunner.gap.answer.rivals import SILENT, Explanation, Layout, explanations
from planrunner.gap.hypotheses.candidates import Candidate, Weighing
from planrunner.plan.schedule import Segment

Seconds = Callable[[Segment | None, Segment], float]
SETTLED = 0.95
"""Probability of an explanation at and above which no further measurement is needed. Proposals aim at a higher probability of the true
explanation."""
AIM = 0.97
FAINT = 0.05
"""Smallest probability of an effect that is worth a measurement if noise alone or something unknown is likeliest."""
LONGEST = 12 * 3600.0  # s of test time
FEWEST = 4
"""Smallest number of segments of a proposal: fewer might be outliers."""
_BUNDLE = 4  # segments at another temperature evaluated together: one rarely justifies the change
_KEPT = 60  # options kept after the first round
_REPEATS = (1, 2, 3, 5, 10, 20, 50)
_HELPS = 0.005  # smallest reduction of the expected loss that justifies a segment


@dataclass(frozen=True)
class SegmentProposal:
    """Segments that a diagnosis proposes to measure next.

    `segments`: the proposed segments in order; empty if nothing on the bench helps. `rivals`: names and present probabilities of
    the explanations that remain possible. `now`: expected probability of the true rival at present. `probability`: expected
    probability of the true rival after `seconds` of test time. `repeating`: the time [s] for which the recorded segments would have
    to be repeated, and the expected probability of the true rival after this time. `sensor`: description of an instrument that
    could distinguish the rivals if the segments of the bench cannot.
    """

    segments: tuple[Segment, ...]
    rivals: tuple[tuple[str, float], ...]
    now: float
    probability: float
    seconds: float
    repeating: tuple[float, float]
    sensor: str = ""


def propose(
    weighing: Weighing,
    found: Posterior,
    candidates: Sequence[Candidate],
    nominal: Sequence[str],
    options: Sequence[Segment],
    seconds: Seconds,
    lasted: float,
) -> SegmentProposal | None:
    """Proposes the segments to measure next; None if one explanation is clear.

    `options`: segments that the bench can execute. `seconds`: function that computes the test time of a segment, including moves,
    settling and dwell. Its arguments are the previous segment (None for the first segment) and the segment itself. `lasted`: test
    time of the recording, s.
    """
    listed = explanations(found, candidates)
    if not options or not _open(listed):
        return None
    observed = weighing.observed
    whole, _ = following(observed, options, ())
    layout = Layout.of(listed, weighing, nominal, whole)
    rivals, recorded = layout.learnt(listed, weighing)
    each = list(foresee(observed, weighing.white, options, layout.columns, layout.widths))
    chosen = _chosen(rivals, each, seconds)
    information = _sum(chosen, len(recorded))
    lasting = _lasting([item.segment for item in chosen], seconds)
    now, then = (expected_probability(rivals, more) for more in (np.zeros_like(information), information))
    names = tuple((rival.name, rival.probability) for rival in rivals)
    repeated = _repeating(rivals, recorded, lasted, then)
    sensor = helpful(weighing, rivals, layout, options) if then < ENOUGH else ""
    if then < now + 0.01:
        return SegmentProposal((), names, now, now, 0.0, repeated, sensor)
    return SegmentProposal(tuple(item.segment for item in chosen), names, now, then, lasting, repeated, sensor)


def _open(listed: Sequence[Explanation]) -> bool:
    """True if a further measurement can still change the answer."""
    if len(listed) < 2:
        return False
    least = FAINT if listed[0].name in SILENT else 0.0
    return listed[0].probability < SETTLED and listed[1].probability >= least


def _sum(items: Sequence[Foreseen], size: int) -> Array:
    total = np.zeros((size, size))
    for item in items:
        total += item.whole
    return total


def _lasting(segments: Sequence[Segment], seconds: Seconds) -> float:
    total, last = 0.0, None
    for segment in segments:
        total += seconds(last, segment)
        last = segment
    return total


def _chosen(rivals: Sequence[Rival], options: Sequence[Foreseen], seconds: Seconds) -> list[Foreseen]:
    """Chooses segments greedily, removes unnecessary ones, and groups the others by temperature. The time before the first segment,
    such as a soak of the sensor, is the same for all segments and does not influence the choice."""
    size = len(options[0].within)
    held = [item.segment for item in options if item.segment.ramp_to is None] or [item.segment for item in options]
    ahead = min(seconds(None, segment) - (segment.dwell or 0.0) for segment in held)

    def beyond(before: Segment | None, segment: Segment) -> float:
        lasting = seconds(before, segment)
        return lasting if before else max(lasting - ahead, segment.dwell or 0.0)

    total, chosen = np.zeros((size, size)), list[Foreseen]()
    loss, spent = float(expected_loss(rivals, total)), 0.0
    running: list[list[Foreseen]] = [[item] for item in options]
    first = True
    while spent < LONGEST and (len(chosen) < FEWEST or expected_probability(rivals, total) < AIM):
        last = chosen[-1].segment if chosen else None
        gains = _gains(rivals, total, loss, running)
        costs = [_chain(last, move, beyond) for move in running]
        if first:
            running, gains, costs = _shortened(running, gains, costs, rivals, size, last, beyond)
            first = False
        rate = np.array(gains) / np.array(costs)
        if len(chosen) < FEWEST:  # without those already selected
            rate[[any(item is taken for item in move for taken in chosen) for move in running]] = -np.inf
        best = int(np.argmax(rate))
        enough = expected_probability(rivals, total) >= AIM
        if gains[best] < (0.0 if enough else _HELPS * len(running[best])):
            break
        chosen += running[best]
        spent += costs[best]
        total = _sum(chosen, size)
        loss = float(expected_loss(rivals, total))
    return _by_temperature(_needed(rivals, chosen, size))


def _gains(rivals: Sequence[Rival], total: Array, loss: float, moves: Sequence[Sequence[Foreseen]]) -> list[float]:
    """How much each move reduces the expected loss if the information `total` (P, P) is already available. A move is one segment or
    a bundle of segments."""
    after = np.array([total + _sum(move, len(total)) for move in moves])
    gains: list[float] = (loss - expected_loss(rivals, after)).tolist()
    return gains


def _chain(last: Segment | None, move: Sequence[Foreseen], seconds: Seconds) -> float:
    total = 0.0
    for item in move:
        total += seconds(last, item.segment)
        last = item.segment
    return total


def _shortened(
    running: list[list[Foreseen]],
    gains: list[float],
    costs: list[float],
    rivals: Sequence[Rival],
    size: int,
    last: Segment | None,
    seconds: Seconds,
) -> tuple[list[list[Foreseen]], list[float], list[float]]:
    """Shortens the list of moves: keeps the best by gain and by gain per second, and adds bundles of the best moves at each
    temperature."""
    by_gain, by_rate = np.argsort(-np.array(gains)), np.argsort(-np.array(gains) / np.array(costs))
    temperatures: dict[float | None, list[int]] = {}
    for index in by_gain:
        temperatures.setdefault(_warmth(running[index][0].segment), []).append(int(index))
    kept = dict.fromkeys([*by_gain[:_KEPT].tolist(), *by_rate[:_KEPT].tolist()])
    for members in temperatures.values():
        kept |= dict.fromkeys(members[:_BUNDLE])
    bundles = [[running[i][0] for i in members[:_BUNDLE]] for members in temperatures.values() if len(members) > 1]
    nothing = np.zeros((size, size))
    loss = float(expected_loss(rivals, nothing))
    for bundle in bundles if len(temperatures) > 1 else []:
        gains += _gains(rivals, nothing, loss, [bundle])
        costs.append(_chain(last, bundle, seconds))
        running.append(bundle)
        kept[len(running) - 1] = None
    return [running[i] for i in kept], [gains[i] for i in kept], [costs[i] for i in kept]


def _warmth(segment: Segment) -> float | None:
    return segment.ramp_to if segment.ramp_to is not None else segment.temperature


def _needed(rivals: Sequence[Rival], chosen: list[Foreseen], size: int) -> list[Foreseen]:
    """Removes those of the chosen segments that are not needed, because the target is reached without them. If the target is out of
    reach, the target is the probability that all chosen segments together give."""
    aim = min(AIM, expected_probability(rivals, _sum(chosen, size)) - 1e-4)
    index = 0
    while index < len(chosen) and len(chosen) > FEWEST:
        others = chosen[:index] + chosen[index + 1 :]
        if expected_probability(rivals, _sum(others, size)) >= aim:
            chosen = others
        else:
            index += 1
    return chosen


def _by_temperature(chosen: Sequence[Foreseen]) -> list[Foreseen]:
    """The segments grouped by temperature; the groups have the order in which their temperatures first appear."""
    order = list(dict.fromkeys(_warmth(item.segment) for item in chosen))
    return sorted(chosen, key=lambda item: order.index(_warmth(item.segment)))


def _repeating(rivals: Sequence[Rival], recorded: Array, lasting: float, aim: float) -> tuple[float, float]:
    """Returns the test time [s] for which the recorded segments must be repeated until the true explanation has the expected
    probability `aim`, and the expected probability that is then reached. If no number of repetitions is enough, both values are
    those for the largest number considered."""
    for times in _REPEATS:
        reached = expected_probability(rivals, recorded * times)
        if reached >= aim:
            break
    return times * lasting, reached
