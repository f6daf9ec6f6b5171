"""An oracle that knows the generator: its signatures, the true noise, the priors of the campaign; what it misses, nobody can be asked for.

Amplitudes of linear effects are Gaussian with the generator's natural magnitudes and a common scale whose λ is log-uniform over the
campaign's range; non-linear effects are weighed on a grid of amplitudes, linear within a cell. Of an effect off the catalogue it is told
the shape. Signatures are those of an ideal device (matrix = identity).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import log_ndtr, logsumexp

from tests.blind.device import ideal, limit, lock_in
from tests.blind.effects import CATALOGUE, FOREIGN, applies
from tests.blind.folder import Shown
from tests.blind.generator import COMPOSITION, SEEN, STRONGEST, WEAKEST, WRONG_BY
from tests.blind.library import Block, Weighed, library
from tests.blind.motion import Array, Fault
from tests.blind.signatures import CELL, STRONG, WEAK, change, excess_ratio

ENERGIES = np.geomspace(WEAKEST, STRONGEST, 20)
PAIR_ENERGIES = np.geomspace(WEAKEST, STRONGEST, 6)
LEADING = 5  # effects that pairs are built on
SPIKE = 6.0  # σ beyond its neighbours, from where a sample is an outlier
CERTAIN = 1e9  # log Bayes factor of what is seen and not inferred: a coarser lattice
REFITS = 2  # of the device, with the best amplitude of such an effect taken off
FINE = 1.05  # ratio of neighbouring amplitudes around the best of an effect that is scanned on the device as fitted
BY_DEVICE = ("gyro_dead_zone", "gyro_saturation")  # where these act depends on the device's own bias and scale factors


def label_of(shown: Shown) -> dict[str, Any]:
    path = shown.folder.parents[1] / "sealed" / f"{shown.name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["label"]


def without_spikes(weighed: Weighed, values: Array) -> Array:
    """Outputs with samples that stick out of the residual put back to their neighbours."""
    values = values.copy()
    for _ in range(2):
        residual = weighed.residual(values)
        off = residual - median_filter(residual, size=(5, 1), mode="nearest")
        level = np.maximum(1.0, 1.4826 * np.median(np.abs(off), axis=0))  # noise may be larger than weighed
        spikes = np.abs(off) > SPIKE * level
        sigma = np.array([weighed.solved[c // 3][0] for c in range(values.shape[1])])
        values -= np.where(spikes, off, 0.0) * sigma
    return values


def evidence(gram: Array, products: Array, variances: Array, energies: Array = ENERGIES) -> float:
    """Log Bayes factor of Gaussian amplitudes, averaged over the common scale."""
    root = np.sqrt(variances)
    values, vectors = np.linalg.eigh(root[:, None] * gram * root)
    values = np.maximum(values, 0.0)
    along = vectors.T @ (root * products)
    s = (energies / max(values.sum(), 1e-300))[:, None]
    each = -0.5 * np.log1p(s * values).sum(1) + 0.5 * (s * along**2 / (1 + s * values)).sum(1)
    return float(logsumexp(each) - np.log(len(energies)))


def _log_normal_mass(low: Array, high: Array) -> Array:
    """log(Φ(high) − Φ(low)), accurate in both tails."""
    flip = low > 0
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    first, second = log_ndtr(high), log_ndtr(low)
    return first + np.log1p(-np.exp(np.minimum(second - first, -1e-12)))


def _possible(energies: Array) -> Array:
    return (energies > WEAKEST / 4) & (energies < STRONGEST * 4)


def cell_evidence(energies: Array, products: Array, ratio: float, cells: float | None = None) -> float:
    """Log Bayes factor of a non-linear effect: amplitude log-uniform over the cells, whose signatures have these energies; over so many
    `cells`, where only some of them are given."""
    inside = _possible(energies)
    if not inside.any():
        return -np.inf
    e, h = energies[inside], products[inside]
    low, high = ratio**-0.5, ratio**0.5
    mass = _log_normal_mass((low - h / e) * np.sqrt(e), (high - h / e) * np.sqrt(e))
    each = 0.5 * h**2 / e + 0.5 * np.log(2 * np.pi / e) + mass - np.log(high - low)
    return float(logsumexp(each) - np.log(cells or len(e)))


def _key(first: str, second: str) -> str:
    return "+".join(sorted((first, second)))


@dataclass(frozen=True)
class Scan:
    """A non-linear effect at several amplitudes: λ, inner product with the residual, change of the output."""

    energies: Array
    products: Array
    differences: list[Array]
    amplitudes: list[float]

    @property
    def best(self) -> int:
        """The likeliest amplitude, as it is."""
        return int(np.argmax(self.products - self.energies / 2))

    @property
    def gain(self) -> float:
        """By how much the best amplitude lowers the squared residual."""
        return float(2 * self.products[self.best] - self.energies[self.best])


class Opinion:
    """The oracle's weighing of one case."""

    def __init__(self, shown: Shown):
        self.label = label_of(shown)
        self.shown = shown
        self.library = library(shown.plan, shown.sensor.name)
        self.weighed = self.library.weighed(tuple(self.label["noise_factors"]))
        self.values = without_spikes(self.weighed, shown.outputs)
        self.residual = self.weighed.residual(self.values)
        self.products = self.weighed.products(self.residual)
        self.gram = self.weighed.gram
        self.best: dict[str, tuple[Block, float]] = {}

    def _blocks(self, effect: str) -> list[Block]:
        return [b for b in self.library.blocks if b.effect == effect and self.weighed.kept(b) >= SEEN]

    def single(self, effect: str) -> float:
        """Log Bayes factor against none; −∞ where the plan cannot see the effect."""
        if effect in BY_DEVICE:
            return self._by_device(effect)
        blocks = self._blocks(effect)
        if not blocks:
            return -np.inf
        g, h = self.gram, self.products
        each = [evidence(g[b.rows, b.rows], h[b.rows], b.variances) for b in blocks]
        self.best[effect] = max(zip(blocks, each, strict=True), key=lambda pair: pair[1])
        if blocks[0].linear:
            return float(logsumexp(each) - np.log(len(each)))
        rows = [b.rows.start for b in blocks]
        return cell_evidence(g[rows, rows], h[rows], CELL)

    def _by_device(self, effect: str) -> float:
        """A non-linear effect of the gyro on the device as fitted; its best amplitude joins the stack of columns."""
        rate = self._fitted_rate(0.0)
        found = self._scan(effect, rate, self._top(effect))
        for _ in range(REFITS):
            if found is None or found.gain < 2 * np.log(STRONGEST):
                break
            rate = self._fitted_rate(found.differences[found.best])
            found = self._scan(effect, rate, self._top(effect))
        if found is None:
            return -np.inf
        value = cell_evidence(found.energies, found.products, CELL)
        cells = float(_possible(found.energies).sum() * np.log(CELL) / np.log(FINE))
        for _ in range(REFITS if found.gain > 2 * np.log(STRONGEST) else 0):
            rate, near = self._fitted_rate(found.differences[found.best]), found.amplitudes[found.best]
            fine = self._scan(effect, rate, CELL * near, near / CELL, FINE)
            if fine is None:
                break
            found, value = fine, cell_evidence(fine.energies, fine.products, FINE, cells)
        self.best[effect] = self._joined(effect, found), found.gain / 2
        return value

    def _top(self, effect: str) -> float:
        return float(CATALOGUE[effect].largest * CATALOGUE[effect].scale[0])

    def _scan(self, effect: str, rate: Array, top: float, least: float = 0.0, ratio: float = CELL) -> Scan | None:
        """The effect at all amplitudes from the largest on at which it can be seen, on an output without noise."""
        amplitude, least = top, max(least, 1e-7 * top)
        energies, products, differences, amplitudes = [], [], [], []
        while amplitude > 0.999 * least:
            stop = limit(rate, amplitude)
            acted = lock_in(rate, amplitude) if effect == "gyro_dead_zone" else np.clip(rate, -stop, stop)
            energy = self._cleared(acted - rate)[1]
            if energy < WEAK:
                break
            if energy < STRONG:
                energies.append(energy)
                products.append(float(np.sum((acted - rate) * self.residual[:, :3]) / self.weighed.solved[0][0]))
                differences.append(acted - rate)
                amplitudes.append(amplitude)
            amplitude /= ratio
        return Scan(np.array(energies), np.array(products), differences, amplitudes) if energies else None

    def _cleared(self, difference: Array) -> tuple[Array, float]:
        """A change of the gyros (n, 3) in σ with the nominal parameters taken out, and its λ."""
        whole = np.zeros_like(self.values)
        whole[:, :3] = difference
        cleared = self.weighed.residual(whole)[:, :3]
        return cleared, float(np.sum(cleared * difference) / self.weighed.solved[0][0])

    def _joined(self, effect: str, found: Scan) -> Block:
        whole = np.zeros_like(self.values)
        whole[:, :3] = self._cleared(found.differences[found.best])[0]
        cross = self.weighed.products(whole)
        extra = np.zeros(len(self.gram) - len(cross))  # with each other these two are taken as independent
        cross = np.r_[cross, extra]
        row = len(self.gram)
        self.gram = np.block([[self.gram, cross[:, None]], [cross[None], np.array([[found.energies[found.best]]])]])
        self.products = np.r_[self.products, found.products[found.best]]
        return Block(effect, slice(row, row + 1), np.ones(1), (), False, found.amplitudes[found.best])

    def _fitted_rate(self, taken: Array | float) -> Array:
        """The gyros' output by the nominal parameters that fit this recording once `taken` is taken off it, °/s."""
        felt = self.library.around.schedule.nominal
        basis = np.column_stack([felt.rate, np.ones(len(felt.time))])
        return basis @ np.linalg.lstsq(basis, self.values[:, :3] - taken, rcond=None)[0]

    def excess(self, effect: str | None = None) -> float:
        """Log Bayes factor of more white noise than a wrong declaration explains, alone or with an effect at its best shape."""
        gyro = self.residual[:, :3]
        n, s = gyro.size, float(np.sum(gyro**2))
        most = WRONG_BY / self.label["noise_factors"][0]
        f = np.array([most * excess_ratio(e) for e in np.geomspace(WEAKEST, STRONGEST, 40)])
        each = -n * np.log(f) + 0.5 * s * (1 - f**-2)
        if effect is not None:
            block = self.best[effect][0]
            gram, h = self.gram[block.rows, block.rows], self.products[block.rows]
            each = each + [evidence(gram / k**2, h / k**2, block.variances) for k in f]
        return float(logsumexp(each) - np.log(len(f)))

    @cached_property
    def step(self) -> float:
        """Distance of neighbouring values of a gyro, °/s."""
        declared = self.shown.bench["channels"]["gyro"]["resolution"]
        steps = np.diff(np.unique(np.round(self.shown.outputs[:, 0] / declared)))
        return float(steps.min()) * declared if len(steps) else declared

    def on_lattice(self, effect: str) -> float:
        """Log Bayes factor of an effect under a coarse resolution, whose error of a segment's mean counts as noise.

        White noise σ leaves a sinusoidal error of amplitude (q/π)·exp(−2π²σ²/q²) (Widrow and Kollár, Quantization Noise, 2008).
        """
        sigma, q = self.weighed.solved[0][0], self.step
        mean = (sigma**2 + q**2 / 12) * len(self.shown.segments) / len(self.values)
        left = (q / np.pi * np.exp(-2 * (np.pi * sigma / q) ** 2)) ** 2 / 2
        share = mean / (mean + left)
        block = self.best[effect][0]
        return evidence(self.gram[block.rows, block.rows] * share, self.products[block.rows] * share, block.variances)

    def pair(self, first: str, second: str) -> float:
        """Log Bayes factor of two effects, at the best shape of each."""
        a, b = self.best[first][0], self.best[second][0]
        rows = np.r_[np.arange(a.rows.start, a.rows.stop), np.arange(b.rows.start, b.rows.stop)]
        gram, h = self.gram[np.ix_(rows, rows)], self.products[rows]
        n = len(a.variances)
        trace = [float(np.diag(gram)[:n] @ a.variances), float(np.diag(gram)[n:] @ b.variances)]
        found = []
        for one in PAIR_ENERGIES:
            for other in PAIR_ENERGIES:
                d = np.sqrt(
                    np.r_[a.variances * one / max(trace[0], 1e-300), b.variances * other / max(trace[1], 1e-300)]
                )
                lower = np.linalg.cholesky(np.eye(len(d)) + d[:, None] * (gram + gram.T) / 2 * d)
                half = np.linalg.solve(lower, d * h)
                found.append(-np.log(np.diag(lower)).sum() + 0.5 * half @ half)
        return float(logsumexp(found) - np.log(len(found)))

    def unknown(self) -> float:
        """Log Bayes factor of the effects off the catalogue, the drawn one at its own shape."""
        kinds = [k for k in FOREIGN.values() if applies(k, self.library.around.schedule, self.library.around.sensor)]
        found = [self.single(kind.name) for kind in kinds]
        for entry in self.label["entries"]:
            kind = FOREIGN.get(entry["effect"])
            if kind is not None and kind.linear:
                signature = self.library.around.of(kind, (tuple(entry["shape"]),))[0]
                cleared = np.array([self.weighed.residual(c.astype(float)) for c in signature.columns])
                flat = cleared.reshape(len(cleared), -1)
                found.append(evidence(flat @ flat.T, flat @ self.residual.ravel(), signature.variances))
        return float(logsumexp(found) - np.log(len(kinds)))

    def posterior(self) -> dict[str, float]:
        around = self.library.around
        names = [k.name for k in CATALOGUE.values() if applies(k, around.schedule, around.sensor)]
        single = {name: self.single(name) for name in names if not CATALOGUE[name].covariance}
        seen = [name for name, value in single.items() if np.isfinite(value)]
        coarse = self.step > 1.5 * self.shown.bench["channels"]["gyro"]["resolution"]
        noise = {"gyro_noise_excess": self.excess(), "gyro_quantization": CERTAIN if coarse else -CERTAIN}
        logs = {"none": np.log(COMPOSITION["none"]), "unknown": np.log(COMPOSITION["unknown"]) + self.unknown()}
        count = len(seen) + len(noise)
        for name, value in [*((n, single[n]) for n in seen), *noise.items()]:
            logs[name] = np.log(COMPOSITION["single"] / count) + value
        share = np.log(COMPOSITION["pair"] / (count * (count - 1) / 2))
        leading = sorted(seen, key=lambda name: -single[name])[:LEADING]
        for a, b in combinations(seen, 2):
            if a in leading or b in leading:
                logs[_key(a, b)] = share + self.pair(a, b)
        for name in leading:
            logs[_key(name, "gyro_noise_excess")] = share + self.excess(name)
        for name in seen:
            logs[_key(name, "gyro_quantization")] = share + self.on_lattice(name) + noise["gyro_quantization"]
        top = logsumexp(list(logs.values()))
        return {k: float(np.exp(v - top)) for k, v in sorted(logs.items(), key=lambda item: -item[1])}

    def closure(self) -> dict[str, Any] | None:
        """By what share a refit with the true effects shrinks the true gap."""
        own = [
            e
            for e in self.label["entries"]
            if not e["absorbed"] and not CATALOGUE.get(e["effect"], CATALOGUE["table_tilt"]).covariance
        ]
        nearest = [self._nearest(entry) for entry in own if entry["effect"] in CATALOGUE]
        blocks = [block for block in nearest if block is not None]
        if not blocks or len(blocks) < len(nearest) or any(e["effect"] in BY_DEVICE for e in own):
            return None
        around = self.library.around
        faults = [Fault(e["effect"], np.array(e["theta"]), tuple(e["shape"])) for e in own]
        truth = self.weighed.residual(change(around.schedule, around.sensor, ideal(around.sensor), faults))
        rows = np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in blocks])
        gram = self.gram[np.ix_(rows, rows)]
        prior = np.concatenate([b.variances for b in blocks]) * 1e6
        fitted = np.linalg.solve(gram + np.diag(1 / prior), self.products[rows])
        columns = np.swapaxes(self.library.columns[rows], 1, 2)
        left = truth - self.weighed.residual(np.tensordot(fitted, columns.astype(float), 1))
        before, after = (float(np.linalg.norm(v)) for v in (truth, left))
        return {
            "before": before,
            "after": after,
            "shrinks_by": 1 - after / before,
            "interval_90": None,
            "resolvable": True,
        }

    def _nearest(self, entry: dict[str, Any]) -> Block | None:
        blocks = self._blocks(entry["effect"])
        if not blocks:
            return None
        if not blocks[0].linear:
            scale = CATALOGUE[entry["effect"]].scale[0]
            return min(blocks, key=lambda b: abs(np.log(b.amplitude * scale / entry["theta"][0])))
        if blocks[0].shape:
            return min(blocks, key=lambda b: abs(np.log(b.shape[0] / entry["shape"][0])))
        return blocks[0]


def diagnose(shown: Shown) -> dict[str, Any]:
    """The oracle's answer, in the output contract as far as it goes."""
    opinion = Opinion(shown)
    posterior = opinion.posterior()
    named = next(key for key in posterior if key != "none")
    top = "none" if posterior["none"] >= 0.05 else named
    effects = [] if top in ("none", "unknown") else top.split("+")
    kind = top if top in ("none", "unknown") else "pair" if len(effects) == 2 else "effect"
    total = np.cumsum(list(posterior.values()))
    covering = list(posterior)[: int(np.searchsorted(total, 0.95)) + 1]
    return {
        "posterior": {k: p for k, p in posterior.items() if p > 1e-6},
        "verdict": {"kind": kind, "effects": effects, "class": []},
        "ambiguity_set": covering,
        "closure": opinion.closure(),
    }
