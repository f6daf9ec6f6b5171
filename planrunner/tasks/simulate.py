"""Simulates a plan with added effects. For this purpose, an instrument that adds the effects is inserted into the bench.
Otherwise, the run is an ordinary run.

The bench file in the run folder contains the added effects. The added effects are therefore used when the run is resumed, estimated
or diagnosed, and can be reproduced later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import yaml

from planrunner.base.findings import InputError, Mark
from planrunner.bench.model import driver_of, runs_on_virtual_clock
from planrunner.error_model.virtual_instrument import AddedEffects
from planrunner.instruments.interfaces import TakesEffects
from planrunner.plan import source
from planrunner.plan.parameters import Given
from planrunner.plan.rewriting import appended
from planrunner.tasks.check import Document, Sound, check_plan

if TYPE_CHECKING:
    from planrunner.error_model.added import Addition

OPTION = Mark("--with")
INSTRUMENT = "added"


@dataclass(frozen=True)
class Simulation:
    """Contains the added effects, and the plan after it was checked on the bench with these effects."""

    sound: Sound
    additions: tuple[Addition, ...]

    def words(self) -> list[str]:
        """Describes each effect in one line."""
        return [
            f"{item.id}: " + ", ".join(f"{name} {value}" for name, value in stated(item).items())
            for item in self.additions
        ]


def simulation(
    plan: Path,
    bench: str | None,
    effects: Sequence[str],
    parameters: Mapping[str, Given] = MappingProxyType({}),
) -> Simulation:
    """Checks the plan on a virtual bench with added effects, each given as `EFFECT`, `EFFECT=VALUE` or
    `EFFECT=NAME:VALUE,NAME:VALUE…`. `parameters`: values for parameters of the plan.

    Raises `InputError` with all obstacles.
    """
    today = date.today()
    sound = check_plan(plan, bench, today, parameters).sound()
    check_virtual(sound)
    if not effects:
        return Simulation(sound, ())
    additions = additions_to(sound, [parsed(text) for text in effects], OPTION)
    if sound.bench.approvals is not None:
        message = (
            f"the bench '{sound.bench.name}' requires approvals, and with effects it is not the bench that was approved"
        )
        hint = "name a bench without `approvals` with --bench"
        raise InputError.at(sound.bench.at("approvals"), "approval-other-bench", message, hint)
    shown = sound.bench.origin.mark.file
    text = with_effects(source.decode(sound.bench_bytes, shown), additions)
    added = Document(text.encode(), shown)
    plan_as_read = Document(sound.plan_bytes, sound.file)
    return Simulation(check_plan(plan_as_read, added, today, parameters).sound(), additions)


def stated(item: Addition) -> dict[str, str]:
    """Returns all parameters of an effect with their units, in the form in which a bench file states them."""
    units = {name: "" if text == "1" else f" {text}" for name, text in item.units.items()}
    return {name: f"{value:.12g}{units[name]}" for name, value in item.values.items()}


def check_virtual(sound: Sound) -> None:
    """Raises `InputError` for a bench that cannot simulate."""
    hint = "choose a virtual bench with --bench; `planrunner bench` lists the shipped ones"
    if sound.models.replays or not runs_on_virtual_clock(sound.bench):
        what = "plays back recordings" if sound.models.replays else "has real instruments"
        raise InputError.at(
            Mark(sound.file), "simulate-bench", f"the bench '{sound.bench.name}' {what}: nothing is simulated", hint
        )


def additions_to(sound: Sound, effects: Sequence[tuple[str, Mapping[str, str]]], mark: Mark) -> tuple[Addition, ...]:
    """Returns the effects to add, each with all its parameters. `effects`: pairs of the name of an effect and the stated values of
    its parameters. `mark`: position at which the effects are stated. Raises `InputError` for an effect, a parameter or a value that
    is not possible."""
    from planrunner.error_model.added import addition
    from planrunner.error_model.scheduled import scheduled, sensor_channels

    taken = any(issubclass(driver_of(entry), TakesEffects) for entry in sound.bench.instruments.values())
    channels = sensor_channels(sound.sensor)
    if not taken or not channels:
        message = f"the sensor of the bench '{sound.bench.name}' does not support added effects"
        hint = "use a bench whose sensor is a virtual_imu with outputs such as gyro_x and accel_x"
        raise InputError.at(Mark(sound.file), "simulate-sensor", message, hint)
    if any(issubclass(driver_of(entry), AddedEffects) for entry in sound.bench.instruments.values()):
        message = f"the bench '{sound.bench.name}' already has added effects"
        raise InputError.at(Mark(sound.file), "simulate-twice", message, "add the effects in the bench file instead")
    observed = scheduled(
        sound.schedule.segments,
        sound.models.site,
        channels,
        sound.sensor.sample_rate,
        sound.sensor.nominal_supply,
    )
    found: dict[str, Addition] = {}
    for name, values in effects:
        if name in found:
            raise InputError.at(
                mark, "effect-twice", f"'{name}' is added twice", "give all its parameters in one --with"
            )
        found[name] = addition(name, values, observed, mark)
    return tuple(found.values())


def parsed(text: str, option: str = OPTION.file) -> tuple[str, dict[str, str]]:
    """Splits `EFFECT`, `EFFECT=VALUE` or `EFFECT=NAME:VALUE,NAME:VALUE…` into the name of the effect and its values. A value
    without a parameter name gets the key ''. `option`: name of the command-line option, for messages. Raises `InputError` for a
    text of any other form."""
    name, equals, rest = (part.strip() for part in text.partition("="))
    values: dict[str, str] = {}
    for piece in rest.split(",") if equals else ():
        key, colon, value = piece.partition(":")
        key, value = (key.strip(), value.strip()) if colon else ("", key.strip())
        if not value or key in values:
            hint = f"write for example {option} 'gyro_warm_up=tau:600 s,a_x:0.01 deg/s'"
            raise InputError.at(
                Mark(option), "effect-value", f"'{piece.strip()[:60]}' in '{text[:80]}' is not a value", hint
            )
        values[key] = value
    return name, values


def with_effects(text: str, additions: Sequence[Addition]) -> str:
    """Returns the text of a bench file with one more instrument, which adds the effects. This instrument comes last in the order in
    which instruments are made safe."""
    entry = {"driver": "added_effects", "effects": {item.id: stated(item) for item in additions}}
    return _with_instrument(text, INSTRUMENT, _flow(entry))


def _flow(value: object) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name}: {_flow(item)}" for name, item in value.items()) + "}"
    return f"'{value}'"


def _with_instrument(text: str, name: str, entry: str) -> str:
    """Returns the text of a bench file with one more instrument after the others, written in the same style."""
    root = yaml.compose(text)
    assert isinstance(root, yaml.MappingNode)  # a bench file that was read
    nodes = {key.value: value for key, value in root.value}
    instruments, order = nodes["instruments"], nodes.get("safe_order")
    changes = [appended(text, instruments, f"{name}: {entry}", instruments.value[-1][1])]
    if order is not None and order.value:
        changes.append(appended(text, order, name, order.value[-1], "- "))
    for at, more in sorted(changes, reverse=True):
        text = text[:at] + more + text[at:]
    return text
