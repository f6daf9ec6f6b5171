"""Adds the effects that a diagnosis names to the plan or to the simulated bench. In the plan, they form an estimate with
uncertainties and a budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import yaml

from planrunner.base.findings import InputError, Mark
from planrunner.error_model.effects.interface import (
    Follows,
    FollowsSurroundings,
    FollowsTemperature,
    PerOrientation,
    effect_named,
)
from planrunner.error_model.observed import orientation_key
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.foresight import design_of
from planrunner.estimators.interface import Design, EffectAbsentError, EstimationError
from planrunner.plan import source
from planrunner.plan.rewriting import appended
from planrunner.plan.schedule import RecordedMotion, Rest, Segment, Spin
from planrunner.plan.units import unit
from planrunner.tasks.check import Checked, Document, Sound, check_plan
from planrunner.tasks.simulate import additions_to, check_virtual, with_effects

if TYPE_CHECKING:
    from planrunner.error_model.effects.interface import Effect
    from planrunner.error_model.observed import Observed
    from planrunner.tasks.diagnose import Diagnosed, Recorded

Stated = list[tuple[str, dict[str, str]]]
"""Effects by name, each with its parameters as texts with units."""
ESTIMATE = "diagnosed"
"""Name of the estimate in the plan. If the plan already contains this name, a number is appended."""


def plan_with_estimate(made: Diagnosed) -> Checked:
    """Adds an estimate to the plan of a diagnosis. For each output, this estimate contains the named effects and the terms that
    the simulation of the output fits. Terms that the segments do not determine or separate are left out, and a comment in the plan
    names them.

    The result is a checked plan: its text is in `plan_bytes`, and the check shows whether the segments of the plan can separate the
    effects. Raises `InputError` if none of the named effects can be estimated.
    """
    recorded, named = made.recorded, made.diagnosis.verdict.named
    sound, where = recorded.sound, Mark(recorded.where)
    observed = made.diagnosis.grounds.weighing.observed
    if observed.along is not None:
        message = "the orientations are unknown, so no columns of effects are known"
        raise InputError.at(where, "gap-estimate", message, "use accelerometer_multi_position with gravity_magnitude")
    # Named effects come first: of terms that the segments do not separate, the last is left out.
    effects = {name: effect_named(name) for name in dict.fromkeys((*named, *made.diagnosis.grounds.nominal))}
    outputs = _outputs(observed, effects)
    hint = "use --compare, which adds the effect to a simulation" if sound.models.replays else "use --write-bench"
    if not any(name in own for own in outputs.values() for name in named):
        why = "; ".join(f"{name}: {_why_not(effects[name], observed)}" for name in named)
        raise InputError.at(where, "gap-estimate", f"the named effect cannot be estimated: {why}", hint)
    used = Rest | Spin | RecordedMotion
    labels = [segment.label for segment in sound.schedule.segments if isinstance(segment.motion, used)]
    keys: dict[str, object] = {"estimator": "error_model"}
    if len(labels) < len(sound.schedule.segments):
        keys["segments"] = labels
    keys |= _channels(recorded, [effects[name] for name in named])
    original = source.decode(sound.plan_bytes, sound.file)
    bench = Document(sound.bench_bytes, sound.bench.origin.mark.file)
    left_out: dict[str, list[str]] = {}
    while True:
        name, text = _with_estimate(original, {**keys, "outputs": outputs}, left_out)
        checked = check_plan(Document(text.encode(), sound.file), bench)
        if not _reduced(_design_as_recorded(checked, name, recorded), outputs, left_out):
            break
    kept = {term.partition(".")[0] for terms in outputs.values() for term in terms}
    refused = [finding.message for finding in checked.findings if finding.severity == "error"]
    if refused or kept.isdisjoint(named):
        reasons = refused or [f"{name}: the segments that an estimate can use do not determine it" for name in named]
        raise InputError.at(where, "gap-estimate", f"the named effect cannot be estimated: {'; '.join(reasons)}", hint)
    return checked


def _design_as_recorded(checked: Checked, name: str, recorded: Recorded) -> Design | EffectAbsentError | None:
    """Returns the design of an estimate on the segments of a plan. A temperature, supply voltage or pressure that the segments do
    not state has its recorded mean, if the estimate names the channel. Returns the error if an effect does not act on an output in
    these segments, and None if the estimate is not valid for another reason."""
    plan, sound = checked.plan, recorded.sound
    spec = None if plan is None else plan.estimates.get(name)
    if spec is None or not isinstance(spec.parameters, ErrorModelParameters):
        return None
    parameters, found = spec.parameters, {one.label: one for one in recorded.segments}

    def mean(segment: Segment, channel: str | None, stated: float | None) -> float | None:
        one = found.get(segment.label)
        if stated is not None or channel is None or one is None or channel not in one.units:
            return stated
        return unit(one.units[channel]).to_si(float(one.statistics.mean[one.statistics.of(channel)]))

    segments = [
        replace(
            segment,
            temperature=segment.temperature
            if segment.begins_at is not None
            else mean(segment, parameters.temperature_channel, None),
            supply_voltage=mean(segment, parameters.supply_channel, segment.supply_voltage),
            ambient_pressure=mean(segment, parameters.pressure_channel, segment.ambient_pressure),
        )
        for segment in sound.schedule.segments
    ]
    try:
        return design_of(name, spec, segments, sound.models.site, sound.sensor, checked.designs, checked.setup)
    except EffectAbsentError as absent:
        return absent
    except EstimationError:
        return None


def _reduced(
    design: Design | EffectAbsentError | None, outputs: dict[str, list[str]], left_out: dict[str, list[str]]
) -> bool:
    """Removes the terms that the segments of a plan do not determine or separate from `outputs`, and enters them in `left_out`.
    Returns False if there are none, or if no term of any output would remain. `design`: design of the estimate, or an error about
    one effect that does not act on an output."""
    if isinstance(design, EffectAbsentError):
        output = design.output
        absent = [term for term in outputs[output] if term.partition(".")[0] == design.effect]
        if not absent or outputs == {output: absent}:
            return False
        left_out.setdefault(output, []).extend(absent)
        outputs[output] = [term for term in outputs[output] if term not in absent]
        if not outputs[output]:
            del outputs[output]
        return True
    found = [] if design is None else [one for one in design.remarks if one.superfluous]
    changes = {one.key.removeprefix("outputs."): one for one in found}
    if not changes or all(output in changes and not changes[output].keeps for output in outputs):
        return False
    for output, remark in changes.items():
        out = {effect for effect, _ in remark.superfluous}
        terms: list[str] = []
        for effect, column in remark.keeps:
            terms.append(f"{effect}.{column}" if effect in out else effect)
        left_out.setdefault(output, []).extend(f"{effect}.{column}" for effect, column in remark.superfluous)
        if terms:
            outputs[output] = list(dict.fromkeys(terms))
        else:
            del outputs[output]
    return True


def _channels(recorded: Recorded, effects: Sequence[Effect]) -> dict[str, object]:
    """Returns the keys of an estimate that name the channels of temperature, supply voltage and ambient pressure, if effects depend
    on these quantities. The channels are those that the diagnosis used. A temperature channel is named only if a segment states no
    temperature."""
    from planrunner.tasks.diagnose import only_channel

    followed = {effect.follows for effect in effects if isinstance(effect, FollowsSurroundings)}
    units, found = recorded.segments[0].units, dict[str, object]()
    for follows, key, dimension in (
        (Follows.SUPPLY, "supply_channel", "voltage"),
        (Follows.PRESSURE, "pressure_channel", "pressure"),
    ):
        channel = only_channel(units, dimension) if follows in followed else None
        if channel is not None:
            found[key] = channel
    unstated = any(one.segment.temperature is None and one.segment.ramp_to is None for one in recorded.segments)
    if unstated and any(isinstance(effect, FollowsTemperature) for effect in effects):
        channel = only_channel(units, "temperature")
        if channel is not None:
            found["temperature_channel"] = channel
    return found


def bench_with_effects(made: Diagnosed, simulation: str | None = None) -> str:
    """Returns the text of a bench file with the named effects added, each with its estimated size. `simulation`: the virtual bench,
    as a name or a file; by default, the bench of the recording. Raises `InputError` if the bench cannot simulate the effects."""
    base = simulated_by(made.recorded, simulation)
    shown = base.bench.origin.mark.file
    observed = made.diagnosis.grounds.weighing.observed
    stated = as_planned(stated_effects(made), observed, base.schedule.segments)
    return with_effects(source.decode(base.bench_bytes, shown), additions_to(base, stated, Mark(made.recorded.where)))


def simulated_by(recorded: Recorded, simulation: str | None = None) -> Sound:
    """Returns the plan of a recording, checked on a virtual bench. `simulation`: the virtual bench, as a name or a file; by
    default, the bench of the recording. Raises `InputError` if the bench cannot simulate or cannot run the plan."""
    sound = recorded.sound
    if simulation is not None:
        sound = check_plan(Document(sound.plan_bytes, sound.file), simulation).sound()
    check_virtual(sound)
    return sound


def stated_effects(made: Diagnosed) -> Stated:
    """Returns the named effects with their parameters as texts. Orientations are numbered as in the diagnosis."""
    return [
        (
            name,
            {
                one.name: f"{one.value:.9g}" + ("" if one.unit == "1" else f" {one.unit}")
                for one in made.diagnosis.parameters
                if one.effect == name
            },
        )
        for name in made.diagnosis.verdict.named
    ]


def as_planned(stated: Stated, observed: Observed, segments: Sequence[Segment]) -> Stated:
    """Renumbers the orientations in the effects of a diagnosis, so that the numbers agree with a simulation of `segments`. A
    simulation numbers the orientations of `segments` in the order of first use, and a diagnosis numbers the orientations of the
    recorded segments."""
    seen = list(dict.fromkeys(map(orientation_key, observed.attitude)))
    planned = list(dict.fromkeys(orientation_key(np.array(s.attitude)) for s in segments if s.attitude is not None))
    return [
        (name, {_renumbered(key, seen, planned): text for key, text in values.items()})
        if isinstance(effect_named(name), PerOrientation)
        else (name, values)
        for name, values in stated
    ]


def _renumbered(name: str, seen: Sequence[tuple[float, ...]], planned: Sequence[tuple[float, ...]]) -> str:
    """Replaces the number in a name such as `orientation_3_x` by the number of the same orientation among the planned
    orientations."""
    word, number, axis = name.split("_")
    place = seen[int(number) - 1]
    return name if place not in planned else f"{word}_{planned.index(place) + 1}_{axis}"


def _why_not(effect: Effect, observed: Observed) -> str:
    """Returns the reason why an estimate cannot contain an effect; empty if it can."""
    from planrunner.error_model.effects.interface import is_whole
    from planrunner.error_model.segment_columns import estimable

    columns = [column for variant in effect.variants(observed) for column in variant.columns]
    if why := estimable(effect):
        return why
    if not columns or is_whole(columns):
        return "it has no amplitude on the outputs of the plan"
    return ""


def _outputs(observed: Observed, effects: Mapping[str, Effect]) -> dict[str, list[str]]:
    """Maps each output to the effects that act on it. Leaves out effects that an estimate cannot contain."""
    found: dict[str, list[str]] = {channel.name: [] for channel in observed.channels}
    for name, effect in effects.items():
        if _why_not(effect, observed):
            continue
        columns = [column for variant in effect.variants(observed) for column in variant.columns]
        for place, channel in enumerate(observed.channels):
            if any(place in column.parts and column.parts[place].any() for column in columns):
                found[channel.name].append(name)
    return {name: own for name, own in found.items() if own}


def _with_estimate(text: str, entry: Mapping[str, object], left_out: Mapping[str, Sequence[str]]) -> tuple[str, str]:
    """Returns the name of one more estimate, and the text of the plan with this estimate after the others, written in the same
    style. `left_out`: for each output, terms that a comment names as left out."""
    root = yaml.compose(text)
    assert isinstance(root, yaml.MappingNode)  # a plan that was read
    nodes = {key.value: value for key, value in root.value}
    estimates = nodes.get("estimates")
    if not isinstance(estimates, yaml.MappingNode) or not estimates.value:
        return ESTIMATE, f"{text.rstrip()}\n\nestimates:\n  {_comment(left_out, 2)}{_block(ESTIMATE, entry, 2)}\n"
    taken = {key.value for key, _ in estimates.value}
    name = next(one for one in (ESTIMATE, *(f"{ESTIMATE}_{k}" for k in range(2, 1000))) if one not in taken)
    column = estimates.start_mark.column
    more = (
        f"{name}: {_flow(entry)}" if estimates.flow_style else _comment(left_out, column) + _block(name, entry, column)
    )
    at, written = appended(text, estimates, more, estimates.value[-1][1])
    return name, text[:at] + written + text[at:]


def _comment(left_out: Mapping[str, Sequence[str]], column: int) -> str:
    """Returns comment lines about the terms that are left out; empty if there are none. The first line begins at the given column."""
    pad = "\n" + " " * column
    lines = [f"#   {output}: {', '.join(terms)}" for output, terms in left_out.items()]
    return (
        "".join(line + pad for line in ("# Left out, because the segments do not determine these terms:", *lines))
        if lines
        else ""
    )


def _block(name: str, entry: Mapping[str, object], column: int) -> str:
    """Returns a mapping as YAML text in block style. The first line of the text begins at the given column."""
    pad = "\n" + " " * (column + 2)
    lines = []
    for key, value in entry.items():
        inner = value if isinstance(value, Mapping) else None
        lines.append(f"{key}: {_flow(value)}" if inner is None else _block(key, inner, column + 2))
    return f"{name}:" + "".join(pad + line for line in lines)


def _flow(value: object) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name}: {_flow(item)}" for name, item in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_flow, value)) + "]"
    text = str(value)
    return text if text.replace("_", "").isalnum() and not text[:1].isdigit() else f"'{text}'"
