"""All signatures of one set-up as one stack of columns, with what is needed to weigh them under any true noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from tests.blind.effects import CATALOGUE, FOREIGN, Kind, Shape, applies
from tests.blind.motion import Array, Schedule
from tests.blind.noise import FLAT, flicker_basis, flicker_variance
from tests.blind.plans import PLANS
from tests.blind.real import sensor_called
from tests.blind.signatures import Signature, Signatures

SHAPES_TRIED = 3  # of an effect off the catalogue, beside the one that was drawn
SEED = 17


@dataclass(frozen=True)
class Block:
    """Columns of one effect at one shape (or one amplitude of a non-linear effect): rows of the stack, and prior variances."""

    effect: str
    rows: slice
    variances: Array
    shape: Shape
    linear: bool
    amplitude: float


@dataclass(frozen=True)
class Library:
    """Signatures of the catalogue and, at a few shapes, of what is off it, under one plan and sensor type."""

    around: Signatures

    @cached_property
    def _signatures(self) -> list[tuple[Kind, Signature]]:
        schedule, sensor = self.around.schedule, self.around.sensor
        rng = np.random.default_rng(SEED)
        found = [(CATALOGUE[name], s) for name, spans in self.around.spans.items() for s, _, _ in spans]
        walk = CATALOGUE["gyro_bias_random_walk"]
        found += [(walk, s) for s in self.around.of(walk)]
        for kind in FOREIGN.values():
            if applies(kind, schedule, sensor):
                shapes = tuple(
                    dict.fromkeys(kind.draw(schedule, rng) if kind.draw else () for _ in range(SHAPES_TRIED))
                )
                found += [(kind, s) for s in self.around.of(kind, shapes)]
        return found

    @cached_property
    def blocks(self) -> list[Block]:
        found, row = [], 0
        for kind, s in self._signatures:
            rows = slice(row, row + len(s.columns))
            found.append(Block(s.effect, rows, s.variances, s.shape, kind.linear, s.amplitude))
            row = rows.stop
        return found

    @cached_property
    def columns(self) -> Array:
        """Shape (p, channels, n), float32, one row after the other: they are multiplied many times."""
        return np.ascontiguousarray(np.concatenate([np.swapaxes(s.columns, 1, 2) for _, s in self._signatures]))

    @cached_property
    def _nominal(self) -> list[Array]:
        """Per triad: nominal regressors and flicker, normalised."""
        felt, found = self.around.schedule.nominal, []
        for i, triad in enumerate(self.around.sensor.triads):
            basis = np.column_stack([felt.rate if i == 0 else felt.force, np.ones(len(felt.time))])
            found.append(np.hstack([basis, flicker_basis(felt.time)]) if triad.instability else basis)
        return found

    @cached_property
    def _products(self) -> list[tuple[Array, Array]]:
        """Per channel: inner products of the columns among themselves and with the nominal regressors."""
        found = []
        for channel in range(self.columns.shape[1]):
            mine = np.ascontiguousarray(self.columns[:, channel])
            found.append(
                ((mine @ mine.T).astype(float), (mine @ self._nominal[channel // 3].astype(np.float32)).astype(float))
            )
        return found

    def _solved(self, triad: int, factor: float, flicker: bool) -> tuple[float, Array]:
        """σ of a sample and the inverse that projects nominal parameters and, where asked, flicker out."""
        declared = self.around.sensor.triads[triad]
        sigma = self.around.sensor.sigma()[3 * triad] * factor
        basis = self._nominal[triad] if flicker else self._nominal[triad][:, :4]
        prior = np.zeros(basis.shape[1])
        if declared.instability and flicker:
            prior[4:] = sigma**2 / flicker_variance(declared)
        scale = np.linalg.norm(basis, axis=0)
        scale = np.maximum(scale, 1e-9 * scale.max())
        values, vectors = np.linalg.eigh(basis.T @ basis / np.outer(scale, scale) + np.diag(prior / scale**2))
        kept = values > FLAT * values[-1]
        inverse = np.zeros((self._nominal[triad].shape[1],) * 2)
        size = basis.shape[1]
        inverse[:size, :size] = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
        return sigma, inverse

    def weighed(self, factors: tuple[float, ...], flicker: bool = True) -> Weighed:
        """Gram matrix of the columns in a noise, as they are and with the nominal parameters projected out."""
        raw, gram = np.zeros(()), np.zeros(())
        solved = [self._solved(i, f, flicker) for i, f in enumerate(factors)]
        for channel, (own, cross) in enumerate(self._products):
            sigma, inverse = solved[channel // 3]
            raw = raw + own / sigma**2
            gram = gram + (own - cross @ inverse @ cross.T) / sigma**2
        return Weighed(self, solved, raw, gram)


@dataclass(frozen=True)
class Weighed:
    """A library under a true noise."""

    library: Library
    solved: list[tuple[float, Array]]
    raw: Array
    gram: Array

    def residual(self, values: Array) -> Array:
        """Outputs (n, channels) in σ with the nominal parameters and the flicker taken out."""
        found = np.empty_like(values)
        for channel in range(values.shape[1]):
            sigma, inverse = self.solved[channel // 3]
            basis = self.library._nominal[channel // 3]
            y = values[:, channel]
            found[:, channel] = (y - basis @ (inverse @ (basis.T @ y))) / sigma
        return found

    def products(self, residual: Array) -> Array:
        """Inner products of all columns with a residual: shape (p,)."""
        sigma = np.array([self.solved[c // 3][0] for c in range(residual.shape[1])])
        weighed = np.ascontiguousarray((residual / sigma).T, np.float32).ravel()
        return (self.library.columns.reshape(len(self.library.columns), -1) @ weighed).astype(float)

    def kept(self, block: Block) -> float:
        """Share of the signature's energy that the nominal parameters leave."""
        rows = block.rows
        return float(np.trace(self.gram[rows, rows]) / max(np.trace(self.raw[rows, rows]), 1e-300))


@lru_cache(maxsize=2)
def library(plan: str, sensor: str) -> Library:
    kind = sensor_called(sensor)
    return Library(Signatures(Schedule(PLANS[plan], kind.sampling), kind))
