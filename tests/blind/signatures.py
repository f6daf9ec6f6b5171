"""Signatures of effects by finite differences of the generator's own simulation, and how far apart two of them are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tests.blind.device import Device, Sensor, clean_output, ideal
from tests.blind.effects import CATALOGUE, Kind, Shape, applies
from tests.blind.motion import Array, Fault, Schedule
from tests.blind.noise import FLAT, Metric

WALK_TERMS = 24  # Karhunen–Loève terms of a random walk, per axis
CELL = 10**0.2  # ratio of consecutive amplitudes at which a non-linear effect's signature is taken
WEAK, STRONG = 1.0, 1e5  # λ between which such signatures are kept
TRUSTED = 0.02  # relative standard deviation with which a declared white noise is trusted
INSEPARABLE = 10.0  # λ(1 − ρ) below which the data cannot tell two effects apart
REPRODUCED = 0.9  # ρ above which they are one class


def change(schedule: Schedule, sensor: Sensor, device: Device, faults: list[Fault]) -> Array:
    """What faults change in the noise-free output, shape (n, channels)."""
    with_them = clean_output(schedule, sensor, device, {fault.effect: fault for fault in faults})
    return with_them - clean_output(schedule, sensor, device, {})


def excess_energy(ratio: float) -> float:
    """λ of white noise that is `ratio` times what it could be without the effect: (ln ratio ÷ trust)²."""
    return float((np.log(ratio) / TRUSTED) ** 2)


def excess_ratio(energy: float) -> float:
    return float(np.exp(TRUSTED * np.sqrt(energy)))


@dataclass(frozen=True)
class Signature:
    """Columns of one effect at one shape: change per natural magnitude of each parameter, shape (p, n, channels), float32."""

    effect: str
    shape: Shape
    columns: Array
    variances: Array  # of the amplitudes, in squares of natural magnitudes
    amplitude: float = 1.0  # of a non-linear effect: where it was taken


@dataclass(frozen=True)
class Signatures:
    """The whole catalogue's signatures under one plan and sensor type, with the ideal device."""

    schedule: Schedule
    sensor: Sensor

    @cached_property
    def metric(self) -> Metric:
        return Metric(self.schedule, self.sensor, (1.0, 1.0))

    def of(self, kind: Kind, shapes: tuple[Shape, ...] | None = None) -> list[Signature]:
        """One for each shape of the effect; for a non-linear effect one for each amplitude."""
        if kind.name == "gyro_bias_random_walk":
            return [self._walk(kind)]
        if not kind.linear:
            return self._cells(kind)
        found = []
        for shape in shapes or kind.shapes:
            columns = self._placing(kind) if kind.name == "table_position_error" else self._columns(kind, shape)
            found.append(Signature(kind.name, shape, columns, np.ones(len(columns))))
        return found

    def _columns(self, kind: Kind, shape: Shape) -> Array:
        size = kind.magnitudes(self.schedule)
        steps = [np.where(np.arange(len(size)) == j, size, 0.0) for j in range(len(size))]
        device = ideal(self.sensor)
        return np.array(
            [change(self.schedule, self.sensor, device, [Fault(kind.name, step, shape)]) for step in steps], np.float32
        )

    def _placing(self, kind: Kind) -> Array:
        """One angle for all orientations at a time, then split by orientation."""
        number = np.array([self.schedule.places.index(s.axes) for s in self.schedule.segments])[self.schedule.index]
        places = len(self.schedule.places)
        rows = []
        for axis in range(3):
            step = np.tile(kind.scale[0] * np.eye(3)[axis], places)
            whole = change(self.schedule, self.sensor, ideal(self.sensor), [Fault(kind.name, step)])
            rows.append([np.where((number == place)[:, None], whole, 0.0) for place in range(places)])
        return np.array([rows[axis][place] for place in range(places) for axis in range(3)], np.float32)

    def _walk(self, kind: Kind) -> Signature:
        time = self.schedule.time
        span = time[-1] - time[0]
        turns = (np.arange(WALK_TERMS) + 0.5) * np.pi
        waves = np.sqrt(2 * span) * np.sin(np.outer(turns, (time - time[0]) / span)) / turns[:, None]
        channels = 3 * len(self.sensor.triads)
        columns = np.zeros((3 * WALK_TERMS, len(time), channels), np.float32)
        for axis in range(3):
            columns[axis * WALK_TERMS : (axis + 1) * WALK_TERMS, :, axis] = kind.scale[axis] * waves
        return Signature(kind.name, (), columns, np.ones(3 * WALK_TERMS))

    def _cells(self, kind: Kind) -> list[Signature]:
        """Signatures at amplitudes from the largest down to where nothing can be seen any more."""
        found, amplitude = [], kind.largest
        while True:
            one = self._cell(kind, amplitude)
            energy = self.metric.energy(one.columns[0].astype(float))
            if energy < STRONG or amplitude < 1e-7 * kind.largest:
                found.append(one)
            if energy < WEAK or amplitude < 1e-7 * kind.largest:
                return found
            amplitude /= CELL

    def _cell(self, kind: Kind, amplitude: float) -> Signature:
        fault = Fault(kind.name, amplitude * np.array(kind.scale))
        whole = change(self.schedule, self.sensor, ideal(self.sensor), [fault])
        return Signature(kind.name, (), np.array([whole], np.float32), np.ones(1), amplitude)

    @cached_property
    def spans(self) -> dict[str, list[tuple[Signature, Array, Array]]]:
        """Effect → per shape its signature, Gram matrix and that matrix's pseudo-inverse.

        Effects on the noise are not here, nor is the random walk: it bends to any slow change, and only its prior tells it from one.
        """
        return {
            kind.name: [self.span(signature) for signature in self.of(kind)]
            for kind in CATALOGUE.values()
            if not kind.covariance
            and kind.name != "gyro_bias_random_walk"
            and applies(kind, self.schedule, self.sensor)
        }

    def span(self, signature: Signature) -> tuple[Signature, Array, Array]:
        clear = np.array([self.metric.clear(column.astype(float)) for column in signature.columns])
        scaled = np.array([self.metric.scaled(column) for column in signature.columns])
        flat = clear.reshape(len(clear), -1), scaled.reshape(len(scaled), -1)
        gram = flat[0] @ flat[1].T
        own = np.maximum(np.diag(flat[1] @ flat[1].T), 1e-300)
        gram = (gram + gram.T) / 2
        kept = np.sqrt(own)
        values, vectors = np.linalg.eigh(gram / np.outer(kept, kept))
        seen = values > max(1e-9, 1e3 * FLAT)  # float32 columns: below it, what is left is rounding
        inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / np.outer(kept, kept)
        return signature, gram, inverse

    def reproduced(self, difference: Array, rival: str) -> float:
        """ρ: the share of a change's λ that the rival reproduces with its best parameters."""
        cleared = self.metric.clear(difference)
        energy = float(np.sum(self.metric.scaled(difference) * cleared))
        if energy <= 0:
            return 1.0
        weighed = self.metric.scaled(cleared).astype(np.float32).ravel()
        best = 0.0
        for signature, _, inverse in self.spans[rival]:
            products = (signature.columns.reshape(len(signature.columns), -1) @ weighed).astype(float)
            best = max(best, float(products @ inverse @ products) / energy)
        return min(best, 1.0)

    def inseparable(self, effect: str, difference: Array, energy: float) -> list[str]:
        """The class of a change: the effect, and what reproduces it nearly whole or, by more than half, within what λ can tell."""
        found = {effect}
        for rival in self.spans:
            if rival != effect:
                share = self.reproduced(difference, rival)
                if share > REPRODUCED or (share > 0.5 and energy * (1 - share) < INSEPARABLE):
                    found.add(rival)
        return sorted(found)
