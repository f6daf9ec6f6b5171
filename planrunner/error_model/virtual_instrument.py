"""The virtual instrument that adds effects of the catalogue to a virtual sensor. A bench file lists this instrument with its
effects, and so documents the simulation.

The instrument connects two independent parts of the code: the virtual sensor passes its outputs without noise to `World.added`, and
`planrunner.error_model.effects` contains the effects.

    added:
      driver: added_effects
      effects:
        gyro_warm_up: {tau: 600 s, a_x: 0.01 deg/s, a_y: 0 deg/s, a_z: -0.02 deg/s}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.documents import Json
from planrunner.base.findings import InputError
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.virtual.added import Gives, Moments
from planrunner.instruments.virtual.noise import GaussMarkov, RandomWalk, generator
from planrunner.instruments.virtual.world import World
from planrunner.plan.kinds import MapOf, Record, Text, key
from planrunner.plan.schedule import Segment
from planrunner.plan.units import ZERO_CELSIUS, unit

if TYPE_CHECKING:
    from planrunner.error_model.added import Addition
    from planrunner.error_model.effects.interface import OutsideKind
    from planrunner.error_model.observed import Observed, TemperatureCourse

NAME = r"[a-z][a-z0-9_]{0,59}"
_CHANGED = 1.0  # K; a smaller difference between segments does not count as a change of temperature
_SLOW: tuple[OutsideKind, ...] = ("random walk", "gauss-markov")
_WALKS = 2  # occasion of the first of four random processes; segments and switching on have other occasions


def _of_axis(item: Addition, kind: OutsideKind, output: str) -> float | None:
    """Returns the parameter of a noise effect for one output; None if the effect does not change the noise of this output."""
    from planrunner.error_model.added import BY_AXIS, NOISE
    from planrunner.error_model.observed import axis_of

    axis = axis_of(output)
    own = None if axis is None else item.values.get(f"{BY_AXIS[kind]}_{'xyz'[axis]}")
    return own if own is not None else item.values.get(NOISE[kind][0])


class AddedEffectsParameters(Record):
    """Lists the effects that a simulation contains beyond the declared errors of its sensor, table and site."""

    effects: dict[str, dict[str, str]] = key(
        MapOf(MapOf(Text(), pattern=r"[A-Za-z][A-Za-z0-9_]{0,59}"), pattern=NAME),
        "Effects by name, each with its parameters in their units; a parameter that is not given has its default "
        "size. `planrunner simulate --help` explains how to list them.",
        {"gyro_warm_up": {"tau": "600 s", "a_x": "0.01 deg/s"}},
    )


class AddedEffects:
    """The instrument that adds the listed effects to the outputs of the virtual sensor."""

    role = "effects"
    Parameters = AddedEffectsParameters

    def __init__(self, parameters: AddedEffectsParameters, world: World):
        self.parameters = parameters
        self.world = world
        self.additions: tuple[Addition, ...] = ()
        self.walks: dict[str, RandomWalk] = {}
        self.varying: dict[str, GaussMarkov] = {}
        self.before: float | None = None  # degC, temperature of the preceding segment
        self.change = 0.0
        self.segment = -1
        self.orientations: list[tuple[float, ...]] = []  # in the order of first use
        self.last: dict[str, float] = {}  # readings before the next samples
        self.past: dict[float, tuple[TemperatureCourse, ...]] = {}

    @classmethod
    def connect(cls, parameters: AddedEffectsParameters, surroundings: Surroundings) -> AddedEffects:
        world = World.of(surroundings)
        if world.added is not None:
            raise InstrumentError("two instruments add effects: put all effects into one of them")
        made = cls(parameters, world)
        world.added = made
        return made

    # -- interface for the virtual sensor ------------------------------------------------------------------------------

    def levels(self, moments: Moments, levels: Mapping[str, Array], gives: Mapping[str, Gives]) -> Mapping[str, Array]:
        from planrunner.error_model.added import added

        observed = self._observed(moments, gives)
        additions = self._known(observed)
        channels = observed.channels
        si = np.column_stack([levels[channel.name] * channel.factor for channel in channels])
        number = self._number(moments.segment)
        changed = added(observed, si, additions, self.world.seed, number) + self._walked(moments, observed)
        self._remember(observed)
        return {**levels, **{c.name: changed[:, i] / c.factor for i, c in enumerate(channels)}}

    def noise(self, output: str, gives: Gives) -> Gives:
        from planrunner.error_model.added import OF_TRIAD
        from planrunner.error_model.effects.interface import OutsideCoefficients, triad_of

        for item in self.additions:
            if not isinstance(item.effect, OutsideCoefficients):
                continue
            kind, own = item.effect.outside, unit(OF_TRIAD[triad_of(item.effect)])
            if kind in ("white", "resolution") and unit(gives.unit).dimension == own.dimension:
                value = _of_axis(item, kind, output)
                if value is None:
                    continue
                value *= own.factor / unit(gives.unit).factor
                gives = replace(gives, white=value) if kind == "white" else replace(gives, step=value)
        return gives

    def readings(self, moments: Moments, samples: Mapping[str, Array]) -> Mapping[str, Array]:
        from planrunner.error_model.added import stuck

        time = moments.time + 0.5 / moments.sample_rate - moments.power_on
        given = {
            name: stuck(name, time, values, self.additions, self.last.get(name)) for name, values in samples.items()
        }
        self.last = {name: float(values[-1]) for name, values in given.items() if len(values)}
        return given

    # -- interface of an instrument ------------------------------------------------------------------------------------

    def read(self) -> Mapping[str, float]:
        return {}

    def identify(self) -> Mapping[str, str]:
        listed = "; ".join(
            f"{name} " + ", ".join(f"{key} {value}" for key, value in values.items())
            for name, values in self.parameters.effects.items()
        )
        return {"manufacturer": "planrunner", "model": "added effects", "effects": listed}

    def make_safe(self) -> None:
        """Does nothing, because nothing moves."""

    def close(self) -> None:
        """Does nothing, because nothing is open."""

    def checkpoint(self) -> Mapping[str, Json]:
        return {
            "before": self.before,
            "change": self.change,
            "orientations": [list(place) for place in self.orientations],
            "past": [
                [value, [[one.time.tolist(), one.temperature.tolist(), one.rate] for one in past]]
                for value, past in self.past.items()
            ],
            "last": self.last,
            "walks": {name: walk.checkpoint() for name, walk in self.walks.items()},
            "varying": {name: bias.checkpoint() for name, bias in self.varying.items()},
        }

    def restore(self, state: Mapping[str, Json]) -> None:
        from planrunner.error_model.observed import TemperatureCourse

        self.before, self.change = state["before"], float(state["change"])
        self.orientations = [tuple(map(float, place)) for place in state.get("orientations", ())]
        self.past = {
            float(value): tuple(TemperatureCourse(np.array(t), np.array(c), float(r)) for t, c, r in past)
            for value, past in state.get("past", ())
        }
        self.last = {name: float(value) for name, value in state.get("last", {}).items()}
        for name, walk in state["walks"].items():
            self.walks[name] = RandomWalk(0.0)
            self.walks[name].restore(**walk)
        for name, bias in state.get("varying", {}).items():
            self.varying[name] = GaussMarkov(0.0, 1.0)
            self.varying[name].restore(**bias)

    # -- internals ----------------------------------------------------------------------------------------------------

    def _known(self, observed: Observed) -> Sequence[Addition]:
        """Returns the effects with the values of all their parameters. The values are determined when the first samples arrive, because
        they depend on the sensor."""
        if len(self.additions) < len(self.parameters.effects):
            from planrunner.error_model.added import addition
            from planrunner.error_model.scheduled import everything

            whole = everything(observed.site, observed.channels, observed.sample_rate)
            try:
                self.additions = tuple(
                    addition(name, values, whole, self.parameters.at(f"effects.{name}"))
                    for name, values in self.parameters.effects.items()
                )
            except InputError as error:
                finding = next(iter(error.findings))
                raise InstrumentError(f"{finding.message}; {finding.hint}") from None
        return self.additions

    def _observed(self, moments: Moments, gives: Mapping[str, Gives]) -> Observed:
        """Turns the samples into a recording of one segment."""
        from planrunner.error_model.observed import ObservedSegment, channel_of, joined

        segment = moments.segment
        if segment.attitude is None:
            raise InstrumentError(f"'{segment.label}' has no orientation; effects cannot be added without one")
        warm = moments.kelvin - ZERO_CELSIUS
        self._note_temperature(segment.index, warm)
        listed = (channel_of(name, one.unit, one.white, 0.0, one.step) for name, one in gives.items())
        channels = tuple(made for made in listed if made is not None)
        step = 1 / moments.sample_rate
        steady = len(warm) < 2
        part = ObservedSegment(
            segment.label,
            segment.motion,
            segment.attitude,
            moments.time + step / 2 - moments.power_on,  # time stamps, at the ends of the sample intervals
            moments.angle,
            moments.rate,
            moments.acceleration,
            warm,
            np.zeros(len(warm)) if steady else np.gradient(warm, step),
            np.zeros((len(warm), len(channels))),
            self.change,
            overvoltage=moments.overvoltage,
            overpressure=moments.overpressure,
        )
        made = joined(self.world.site, channels, [part], magnetic=self.world.site.magnetic_field)
        return replace(made, past=dict(self.past))

    def _remember(self, observed: Observed) -> None:
        """Stores the part of earlier samples that effects with a memory need. Every checkpoint contains this stored part, so it
        must not grow."""
        from planrunner.error_model.effects.interface import DependsOnPast

        for item in self.additions:
            if isinstance(item.effect, DependsOnPast):
                value = item.values[item.effect.shape_name]
                self.past[value] = item.effect.remembered(observed, value)

    def _number(self, segment: Segment) -> int:
        """Returns the number of the segment's orientation, counted from 1 in the order of first use."""
        from planrunner.error_model.observed import orientation_key

        place = orientation_key(np.array(segment.attitude))
        if place not in self.orientations:
            self.orientations.append(place)
        return self.orientations.index(place) + 1

    def _note_temperature(self, index: int, warm: Array) -> None:
        """Updates the sign of the last temperature change at the start of a segment. `index`: index of the segment. `warm`:
        temperatures of the sensor at its first samples."""
        if index != self.segment:
            self.segment = index
            now = float(warm.mean())
            if self.before is not None and abs(now - self.before) > _CHANGED:
                self.change = float(np.sign(now - self.before))
            self.before = now

    def _walked(self, moments: Moments, observed: Observed) -> Array:
        """Returns the slow random changes of the biases at the samples, SI, shape (N, K)."""
        from planrunner.error_model.added import OF_TRIAD, SIGMA
        from planrunner.error_model.effects.interface import OutsideCoefficients, triad_of

        total = np.zeros((len(moments.time), len(observed.channels)))
        for item in self.additions:
            if not isinstance(item.effect, OutsideCoefficients) or item.effect.outside not in _SLOW:
                continue
            triad = triad_of(item.effect)
            occasion = _WALKS + 2 * _SLOW.index(item.effect.outside) + (triad == "accel")
            draw = generator(self.world.seed, round(moments.time[0] * moments.sample_rate), occasion)
            factor = unit(OF_TRIAD[triad]).factor
            for index in observed.of_kind(triad):
                name = observed.channels[index].name
                process: RandomWalk | GaussMarkov
                if item.effect.outside == "random walk":
                    process = self.walks.setdefault(name, RandomWalk(0.0))
                    process.coefficient = item.values["density"] * factor
                else:
                    process = self.varying.setdefault(name, GaussMarkov(0.0, 1.0))
                    process.sigma, process.tau = item.values[SIGMA] * factor, item.values["tau"]
                process.begin(float(moments.time[0]), draw)
                total[:, index] += process.advance(len(moments.time), 1 / moments.sample_rate, draw)
        return total
