"""Closes the gap between a recording and its simulation. The effects that a diagnosis finds are entered into the simulation, and
the plan is simulated again. The recording is then compared with two simulations: one without these effects and one with them. A
recording that is played back is simulated with its recorded motion, without a bench.

`close` repeats these steps: it subtracts the effects found from the recording, and diagnoses the remaining gap. The command ends
when no part of the remaining gap can be attributed to a named effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base import plugins
from planrunner.base.arrays import Array
from planrunner.base.findings import InputError, Mark
from planrunner.base.progress import Announce
from planrunner.plan import source
from planrunner.plan.run_information import gather
from planrunner.tasks import run as running
from planrunner.tasks.check import Document, Sound, check_plan
from planrunner.tasks.diagnose import Diagnosed, Recorded, diagnose_recorded, diagnosed_again, observe, recorded_run
from planrunner.tasks.named_effects import Stated, as_planned, simulated_by, stated_effects
from planrunner.tasks.simulate import additions_to, with_effects

if TYPE_CHECKING:
    from planrunner.error_model.added import Addition
    from planrunner.error_model.observed import Observed
    from planrunner.execution.stopping import StopRequest
    from planrunner.gap.answer.comparison import GapComparison
    from planrunner.gap.answer.diagnosis import DiagnosisOptions

ROUNDS = 6
"""Maximum number of rounds of `close`."""
SMALLEST = 0.01
"""Smallest fraction by which a round must reduce the gap. The gap is measured in standard deviations."""
_OTHER_SEED = 0x5EED


class Ending(Enum):
    """States why `close` ended, in words for the user."""

    NOTHING_LEFT = "noise alone explains the remaining gap"
    NO_NAME = "the catalogue does not contain the cause of the remaining gap"
    NOISE = "an effect on the noise was added, and no further effect can be separated from it"
    AGAIN = "effects that were added before are named again, and cannot be fitted separately"
    NO_GAIN = "the last effect did not reduce the gap, and was not added"
    ROUNDS = "the largest number of rounds was reached"


@dataclass(frozen=True)
class ClosingRound:
    """Contains the results of one round of `close`: the diagnosis of the remaining gap, and the comparison after the effects of
    this diagnosis were entered."""

    made: Diagnosed
    comparison: GapComparison


@dataclass(frozen=True)
class Closed:
    """Contains the result of `close`.

    `first`: diagnosis of the recording. `last`: diagnosis of the gap that remains at the end. `bench`: text of the bench file with
    all effects entered; empty if there are no effects, or if the simulations were computed without a bench.
    """

    first: Diagnosed
    rounds: tuple[ClosingRound, ...]
    last: Diagnosed
    stated: Stated
    bench: str
    ending: Ending


def comparison(
    made: Diagnosed, stop: StopRequest, simulation: str | None = None, stated: Stated | None = None
) -> GapComparison:
    """Compares the recording of a diagnosis with two simulations, one without and one with effects. `simulation`: the virtual bench
    that simulates the plan, as a name or a file; by default, the bench of the recording. A bench that plays recordings back cannot
    simulate; in that case, the simulations are computed for the recorded motion. `stated`: the effects with their parameters, in
    the form in which a diagnosis states them; by default, the effects in its verdict.

    The noise of both simulations is independent of the noise of the recording. Raises `InputError` if the bench cannot simulate the
    plan.
    """
    from planrunner.gap.answer.comparison import compare
    from planrunner.observation.refusals import ObservationError

    grounds, mark = made.diagnosis.grounds, Mark(made.recorded.where)
    stated = stated_effects(made) if stated is None else stated
    try:
        if computed_from_recording(made.recorded, simulation):
            before, after = _computed(made, stated)
        else:
            before, after = _run_twice(made, stated, simulation, stop)
        return compare(grounds.weighing, grounds.nominal, before, after)
    except ObservationError as error:
        raise InputError.at(mark, "gap-compare", str(error), error.hint) from None


def computed_from_recording(recorded: Recorded, simulation: str | None) -> bool:
    """Returns True if simulations are computed for the recorded motion, because the bench plays recordings back and the user names
    no other bench."""
    return simulation is None and recorded.sound.models.replays


def _run_twice(made: Diagnosed, stated: Stated, simulation: str | None, stop: StopRequest) -> tuple[Observed, Observed]:
    """Returns the samples from two runs of the plan on the virtual bench, one without and one with the effects."""
    base, grounds = _base(made.recorded, simulation), made.diagnosis.grounds
    stated = as_planned(stated, grounds.weighing.observed, base.schedule.segments)
    absent, mark = _absent(grounds.nominal, stated), Mark(made.recorded.where)
    with TemporaryDirectory(prefix="planrunner-") as folder:
        before, after = (
            _simulated(_with(base, effects, mark), Path(folder), seed, grounds.nominal, stop)
            for effects, seed in ((absent, 1), ([*absent, *stated], 2))
        )
    return before, after


def _computed(made: Diagnosed, stated: Stated) -> tuple[Observed, Observed]:
    """Returns two simulations for the recorded motion, one without and one with the effects. Each simulation has its own white
    noise and is rounded to counts. The noise levels and the counts are taken from the recording. If an effect changes the noise or
    the count of a channel, the simulation without effects uses the declared value of the channel instead of the value of the
    recording."""
    from planrunner.error_model.added import stuck
    from planrunner.error_model.effects.interface import OutsideCoefficients, triad_of

    weighing = made.diagnosis.grounds.weighing
    seen, fitted = weighing.declared, weighing.fitted()
    additions = _additions(made, stated)
    declared = np.array([channel.white for channel in seen.channels]) * math.sqrt(seen.sample_rate)
    changed = {
        (triad_of(e), e.outside) for e in (one.effect for one in additions) if isinstance(e, OutsideCoefficients)
    }
    excess, coarser = (
        np.array([(channel.kind, outside) in changed for channel in seen.channels])
        for outside in ("white", "resolution")
    )
    level = np.where((excess | coarser) & (declared > 0), declared, weighing.white)
    counts = np.zeros_like(weighing.steps) if seen.bins is not None else weighing.steps
    finer = np.where(coarser, [channel.resolution for channel in seen.channels], counts)
    draw = np.random.default_rng(_OTHER_SEED)
    before = fitted + _before_rounding(level, finer, declared) * draw.standard_normal(fitted.shape)
    sigma = _before_rounding(weighing.white, counts, declared)
    after = _plus(made, fitted, additions) + sigma * draw.standard_normal(fitted.shape)
    for one in additions:
        if isinstance(one.effect, OutsideCoefficients) and one.effect.outside == "random walk":
            after += _walk(seen, triad_of(one.effect), one.in_si("density"), draw)
    before, after = _rounded(before, finer), _rounded(after, counts)
    for index, channel in enumerate(seen.channels):
        after[:, index] = stuck(channel.name, seen.time, after[:, index], additions)
    return _of_counts(seen, before, finer), _of_counts(seen, after, counts)


def _of_counts(seen: Observed, values: Array, counts: Array) -> Observed:
    """Returns the recording `seen` with its samples replaced by other samples (N, K), and the resolution of its channels replaced
    by the counts (K,)."""
    channels = zip(seen.channels, counts.tolist(), strict=True)
    return replace(seen, values=values, channels=tuple(replace(one, resolution=count) for one, count in channels))


def _before_rounding(level: Array, counts: Array, declared: Array) -> Array:
    """Returns the standard deviation of the noise before the samples are rounded, for each of K channels. `level`: standard
    deviation (K,) of the rounded samples. `counts`: the counts (K,). If a count is so coarse that the rounded samples do not show
    the noise, the declared level is returned."""
    from planrunner.gap.evidence.rounding import is_coarse

    left = np.sqrt(np.maximum(level**2 - counts**2 / 12, 0.0))
    return np.where(is_coarse(level, counts), np.minimum(declared, counts), left)


def _rounded(values: Array, counts: Array) -> Array:
    """Returns the samples (N, K), rounded to whole counts (K,). A channel whose count is 0 stays unchanged."""
    whole = np.where(counts > 0, counts, 1.0)
    return np.where(counts > 0, np.round(values / whole) * whole, values)


def _walk(observed: Observed, triad: str, density: float, draw: np.random.Generator) -> Array:
    """Returns a random walk in each channel of a triad, shape (N, K); zero in the other channels. `density`: in the SI unit of the
    triad, divided by √s."""
    steps = np.sqrt(np.diff(observed.time, prepend=observed.time[0]).clip(0.0))
    walk = np.zeros((len(steps), len(observed.channels)))
    own = observed.of_kind(triad)
    walk[:, own] = np.cumsum(density * steps[:, None] * draw.standard_normal((len(steps), len(own))), axis=0)
    return walk


def close(
    recorded: Recorded,
    stop: StopRequest,
    simulation: str | None = None,
    options: DiagnosisOptions | None = None,
    rounds: int = ROUNDS,
    notice: Announce | None = None,
) -> Closed:
    """Repeats four steps: diagnoses, enters the effects found, simulates, and compares. Ends when no part of the remaining gap can
    be attributed to a named effect. Raises `InputError` if the recording cannot be diagnosed or simulated."""
    from planrunner.gap.answer.diagnosis import DiagnosisOptions

    computed = computed_from_recording(recorded, simulation)
    base = None if computed else _base(recorded, simulation)
    first = made = diagnose_recorded(recorded, options, notice=notice)
    grounds = first.diagnosis.grounds
    options = options or DiagnosisOptions(nominal=grounds.nominal)
    entered: Stated = []
    done: list[ClosingRound] = []
    ending = Ending.ROUNDS
    for _ in range(rounds):
        kind = made.diagnosis.verdict.kind
        if kind in ("none", "unknown"):
            ending = Ending.NOTHING_LEFT if kind == "none" else Ending.NO_NAME
            break
        merged = _merged(entered, stated_effects(made))
        if merged is None:  # fitted anew, with the other effects subtracted
            named = made.diagnosis.verdict.named
            others = [one for one in entered if one[0] not in named]
            made = diagnosed_again(first, _without(first, others), options)
            merged = _merged(others, stated_effects(made))
        if merged is None or {name for name, _ in entered} - {name for name, _ in merged}:
            ending = Ending.AGAIN
            break
        found = comparison(first, stop, simulation, merged)
        on_noise = any(_on_noise(name) for name in made.diagnosis.verdict.named)
        before = done[-1].comparison.after_sigma if done else found.before_sigma
        if found.after_sigma > before * (1 - SMALLEST) and not on_noise:
            ending = Ending.NO_GAIN
            break
        entered = merged
        done.append(ClosingRound(made, found))
        if on_noise:
            ending = Ending.NOISE
            break
        made = diagnosed_again(first, _without(first, entered), options)
    text = ""
    if entered and base is not None:
        planned = as_planned(entered, grounds.weighing.observed, base.schedule.segments)
        text = _with(base, planned, Mark(recorded.where)).bench_bytes.decode()
    return Closed(first, tuple(done), made, entered, text, ending)


def _merged(entered: Stated, further: Stated) -> Stated | None:
    """Adds further effects to the effects entered so far. If a linear effect occurs again, its amplitudes are added. Returns None
    if a nonlinear effect, or an effect on the noise, occurs again."""
    from planrunner.error_model.effects.interface import HasShape, effect_named

    merged = dict(entered)
    for name, values in further:
        if name not in merged:
            merged[name] = values
        elif isinstance(effect_named(name), HasShape) or _on_noise(name):
            return None
        else:
            merged[name] = {key: _sum(merged[name].get(key), text) for key, text in values.items()}
    return list(merged.items())


def _sum(first: str | None, second: str) -> str:
    """Returns the sum of two values in the same unit, as a text."""
    number, space, unit = second.partition(" ")
    return second if first is None else f"{float(first.partition(' ')[0]) + float(number):.9g}{space}{unit}"


def _without(made: Diagnosed, stated: Stated) -> Observed:
    """Returns the samples of a diagnosis after subtracting the effects. The contribution of the effects is computed for the
    recorded motion."""
    weighing = made.diagnosis.grounds.weighing
    fitted = weighing.fitted()
    change = _plus(made, fitted, _additions(made, stated)) - fitted
    return replace(weighing.declared, values=weighing.observed.values - change)


def _additions(made: Diagnosed, stated: Stated) -> list[Addition]:
    """Returns the effects to add to a simulation, each with all its parameters. Some effects act in every simulated world, but may
    be missing in the nominal simulation of the diagnosis. The diagnosed amplitude of such an effect is added to its amplitude in
    the simulated world."""
    from planrunner.error_model.added import SHARE, addition
    from planrunner.error_model.effects.interface import InEveryWorld

    grounds = made.diagnosis.grounds
    observed = replace(grounds.weighing.declared, fitted=grounds.weighing.fitted())
    found = []
    for name, values in stated:
        one = addition(name, values, observed, Mark(made.recorded.where))
        if isinstance(one.effect, InEveryWorld) and name not in grounds.nominal:
            one = replace(one, values={**one.values, SHARE: one.values.get(SHARE, 1.0) + 1.0})
        found.append(one)
    return found


def _plus(made: Diagnosed, fitted: Array, additions: Sequence[Addition]) -> Array:
    """Returns the output of the nominal simulation with the effects added, in SI units, shape (N, K)."""
    from planrunner.error_model.added import added

    return added(replace(made.diagnosis.grounds.weighing.declared, fitted=fitted), fitted, additions, 0)


def _on_noise(name: str) -> bool:
    from planrunner.error_model.effects.interface import OutsideCoefficients, effect_named

    effect = effect_named(name)
    return isinstance(effect, OutsideCoefficients) and effect.outside != "line"


def _base(recorded: Recorded, simulation: str | None) -> Sound:
    """Returns the plan of a recording, checked on the virtual bench. Raises `InputError` for a recording whose schedule cannot be
    simulated."""
    if recorded.several:
        message = "several runs are analysed together, and a comparison simulates one plan"
        raise InputError.at(Mark(recorded.where), "gap-compare", message, "compare each run separately, without --also")
    base = simulated_by(recorded, simulation)
    if any(segment.attitude is None for segment in base.schedule.segments):
        message = "the orientations of the recording are unknown, so its plan cannot be simulated"
        raise InputError.at(Mark(recorded.where), "gap-compare", message, "declare the orientations in the plan")
    return base


def _absent(nominal: Sequence[str], stated: Stated) -> Stated:
    """Returns entries that remove certain effects from a simulation: the effects that act in every simulated world but not in the
    nominal simulation of the diagnosis."""
    from planrunner.error_model.effects.interface import InEveryWorld, effect_named

    known = {*nominal, *(name for name, _ in stated)}
    return [
        (name, {"": "0"})
        for name in plugins.names(plugins.EFFECTS)
        if name not in known and isinstance(effect_named(name), InEveryWorld)
    ]


def _with(base: Sound, stated: Stated, mark: Mark) -> Sound:
    """Returns the plan, checked on its bench after the given effects were added to the bench."""
    if not stated:
        return base
    shown = base.bench.origin.mark.file
    text = with_effects(source.decode(base.bench_bytes, shown), additions_to(base, stated, mark))
    return check_plan(Document(base.plan_bytes, base.file), Document(text.encode(), shown)).sound()


def _simulated(sound: Sound, folder: Path, seed: int, nominal: Sequence[str], stop: StopRequest) -> Observed:
    """Returns the samples that a simulation of the plan gives."""
    info = gather(sound.plan, [f"{name}=simulated" for name, item in sound.plan.record.items() if item.required], None)
    run, outcome = running.start(
        sound,
        info=info,
        runs=folder / str(seed),
        stop=stop,
        seed=(sound.bench.seed or 0) + _OTHER_SEED + seed,
        durability="flushed",
    )
    if not outcome.ok:
        hint = "run the plan on the virtual bench with `planrunner simulate` to see the obstacle"
        raise InputError.at(Mark(sound.file), "gap-compare", "the simulation did not finish", hint)
    return observe(recorded_run(run), nominal)[0]
