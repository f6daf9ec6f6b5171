"""Draws a case: device, noise, none, one or two effects of chosen strength; simulates the recording and writes down the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce

import numpy as np

from tests.blind import real
from tests.blind.device import (
    SENSORS,
    Device,
    Sensor,
    accel_noise_factor,
    clean_output,
    clipped,
    coarse,
    noise_factor,
    random_device,
    recorded,
    stuck,
)
from tests.blind.effects import CATALOGUE, FOREIGN, KINDS, Kind, applies
from tests.blind.motion import Array, Fault, Schedule, stimulus
from tests.blind.noise import Metric, noise, outliers
from tests.blind.plans import PLANS
from tests.blind.signatures import Signatures, change, excess_energy, excess_ratio

WEAKEST, STRONGEST = 4.0, 1e4  # λ, log-uniform between
COMPOSITION = {"none": 0.20, "single": 0.50, "pair": 0.15, "unknown": 0.15}
ABSORBED_SHARE = 0.05  # of the singles: effects that the nominal parameters take whole
SEEN = 0.02  # least share of an effect's energy that is left by the nominal parameters
GONE = 1e-3  # below it, the nominal parameters take it whole
WRONG_NOISE, WITH_OUTLIERS = 0.20, 0.10
WRONG_BY = 2.0  # factor, either way, by which a declared noise may be off without any effect
TEMPERATURE_NOISE = 0.02  # degC
TRIES = 400
LATTICES = 4.0  # spacings of real noise that a coarse resolution is at least: finer ones are not dithered by it
COARSEST = 1.25  # by what a coarse resolution may raise the noise (2.6 σ a step): beyond, its errors of segment means are no noise


@dataclass(frozen=True)
class Case:
    """A recording and its truth. `label` is what is sealed: plain data in canonical JSON."""

    name: str
    plan: str
    sensor: str
    columns: dict[str, Array]
    label: dict
    faults: tuple[Fault, ...] = field(repr=False)
    device: Device = field(repr=False)


@lru_cache(maxsize=2)
def signatures(plan: str, sensor: str) -> Signatures:
    """Kept for the plan at work: cases are made plan by plan."""
    kind = real.sensor_called(sensor)
    return Signatures(Schedule(PLANS[plan], kind.sampling), kind)


def stream(seed: int, number: int, part: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, part)))


def assigned(seed: int, number: int, real_noise: bool = False) -> tuple[str, str, str]:
    """Plan, sensor type and kind of case `number`: the same whoever makes it."""
    rng = stream(seed, number, 0)
    if real_noise:
        plan, sensor = real.SETUPS[rng.integers(len(real.SETUPS))]
    else:
        plan = list(PLANS)[rng.integers(len(PLANS))]
        sensor = list(SENSORS)[rng.integers(len(SENSORS))]
    return plan, sensor, str(rng.choice(list(COMPOSITION), p=list(COMPOSITION.values())))


def kept_share(around: Signatures, difference: Array) -> float:
    """Share of a change's energy that the nominal parameters leave."""
    whole = float(np.sum(around.metric.scaled(difference) ** 2))
    return around.metric.energy(difference) / whole if whole else 0.0


def _of_strength(kind: Kind, direction: Array, shape: tuple[float, ...], energy: float, work: Work) -> Fault | None:
    """The fault whose λ is `energy`, or None where no physical amplitude gives it."""
    amplitude, low, high = 1.0, 0.0, np.inf
    if kind.covariance:
        ratio = excess_ratio(energy)
        step = work.sigma[0] * np.sqrt(12 * (ratio**2 - 1))
        if kind.name == "gyro_quantization" and (ratio > COARSEST or step < LATTICES * work.lattice):
            return None
        theta = step if kind.name == "gyro_quantization" else ratio * work.most_noise(kind.name) - 1
        return Fault(kind.name, np.array([theta])) if theta <= kind.largest else None
    for _ in range(1 if kind.linear else 25):
        found = work.energy(kind.fault(direction, amplitude, shape))
        if kind.linear:
            amplitude = amplitude * np.sqrt(energy / found) if found > 0 else np.inf
            break
        if abs(np.log((found + 1e-300) / energy)) < 0.02:
            break
        low, high = (amplitude, high) if found < energy else (low, amplitude)
        step = amplitude * np.clip((energy / max(found, 1e-12)) ** 0.4, 0.1, 10.0)
        amplitude = step if low < step < high else (low + min(high, 10 * low + 1e-9)) / 2
        if low > kind.largest:
            return None
    return kind.fault(direction, amplitude, shape) if amplitude <= kind.largest else None


@dataclass(frozen=True)
class Work:
    """What the draw of one case needs at hand."""

    around: Signatures
    factors: tuple[float, ...]  # true ÷ declared white noise, per triad
    device: Device

    @cached_property
    def metric(self) -> Metric:
        right = all(factor == 1.0 for factor in self.factors)
        return self.around.metric if right else Metric(self.around.schedule, self.around.sensor, self.factors)

    @property
    def sigma(self) -> Array:
        """Of a sample, per channel."""
        return self.around.sensor.sigma() * np.repeat(self.factors, 3)

    @property
    def lattice(self) -> float:
        """Spacing of the values that real noise of the gyros takes, °/s."""
        sensor = self.around.sensor
        return real.background(sensor.name).lattice if sensor.real else 0.0

    def most_noise(self, effect: str) -> float:
        """The largest noise that a wrong declaration explains, of the triad that the effect acts on, in units of the true one.

        What is declared of real noise is the scatter of its samples, so their scatter is compared, not the level after a second.
        """
        triad = int(effect == "accel_noise_excess")
        sensor = self.around.sensor
        return WRONG_BY / self.factors[triad] * (real.true_factors(sensor.name)[triad] if sensor.real else 1.0)

    def noise_ratio(self, fault: Fault) -> float:
        """By how much the fault raises the gyros' noise."""
        if fault.effect == "gyro_quantization":
            return float(np.sqrt(1 + fault.theta[0] ** 2 / (12 * self.sigma[0] ** 2)))
        return noise_factor({fault.effect: fault})

    def under(self, fault: Fault) -> Work:
        """The same in the noise that there is with the fault: what others are measured in."""
        ratio = self.noise_ratio(fault)
        return self if ratio == 1.0 else replace(self, factors=(self.factors[0] * ratio, *self.factors[1:]))

    def difference(self, *faults: Fault) -> Array:
        return change(self.around.schedule, self.around.sensor, self.device, list(faults))

    def energy(self, *faults: Fault) -> float:
        return self.metric.energy(self.difference(*faults))


def _direction(kind: Kind, schedule: Schedule, rng: np.random.Generator) -> Array:
    size = kind.magnitudes(schedule)
    draw = rng.standard_normal(len(size)) if len(size) > 1 else rng.choice([-1.0, 1.0], 1)
    return size * (draw if kind.signed else np.abs(draw))


def one_effect(work: Work, names: list[str], energy: float, rng: np.random.Generator, absorbed: bool = False) -> Fault:
    """One effect among `names` with λ = `energy`, or one that the nominal parameters absorb, at its natural magnitude."""
    schedule, sensor = work.around.schedule, work.around.sensor
    for _ in range(TRIES):
        kind = KINDS[names[rng.integers(len(names))]]
        if not applies(kind, schedule, sensor):
            continue
        shape = kind.draw(schedule, rng) if kind.draw else kind.shapes[0]
        direction = _direction(kind, schedule, rng)
        if not kind.covariance:
            share = kept_share(work.around, work.difference(kind.fault(direction, 1.0, shape)))
            if absorbed and share < GONE:
                return kind.fault(direction, 1.0, shape)
            if absorbed or share < SEEN:
                continue
        elif absorbed:
            continue
        found = _of_strength(kind, direction, shape, energy, work)
        if found is not None:
            return found
    raise RuntimeError(f"no effect of {names} reaches a strength of {energy:g} under this plan")


def _effects(kind: str, work: Work, rng: np.random.Generator) -> list[Fault]:
    energies = np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST), 2))
    names = [name for name in CATALOGUE if name != "table_rate_error"]
    if kind == "none":
        return []
    if kind == "unknown":
        return [one_effect(work, list(FOREIGN), energies[0], rng)]
    if kind == "single":
        if rng.random() < ABSORBED_SHARE:
            return [one_effect(work, [*CATALOGUE, *["table_rate_error"] * len(CATALOGUE)], 0.0, rng, absorbed=True)]
        return [one_effect(work, names, energies[0], rng)]
    return _two(work, names, energies, rng)


def _two(work: Work, names: list[str], energies: Array, rng: np.random.Generator) -> list[Fault]:
    """Two effects that can be told apart; beside one that acts on the noise, the other has its strength in that noise."""
    first = one_effect(work, names, energies[0], rng)
    for _ in range(TRIES):
        second = one_effect(work.under(first), [name for name in names if name != first.effect], energies[1], rng)
        if overlapping(work, first, second):
            continue
        if KINDS[second.effect].covariance:
            still = [name for name in names if not KINDS[name].covariance]
            first = one_effect(work.under(second), still, energies[0], rng)
        return [first, second]
    raise RuntimeError(f"no second effect beside {first.effect} under this plan")


def overlapping(work: Work, first: Fault, second: Fault) -> bool:
    """Whether one of the two would hide the other: more than half of it reproduced, or both act on the noise."""
    still = [fault for fault in (first, second) if not KINDS[fault.effect].covariance]
    if len(still) < 2:
        return not still
    return any(
        work.around.reproduced(work.difference(one), other.effect) > 0.5
        for one, other in ((first, second), (second, first))
        if other.effect in work.around.spans
    )


def strength_of(work: Work, fault: Fault) -> float:
    if fault.effect in ("gyro_noise_excess", "accel_noise_excess"):
        ratio = noise_factor({fault.effect: fault}) * accel_noise_factor({fault.effect: fault})
        return excess_energy(ratio / work.most_noise(fault.effect))
    return excess_energy(work.noise_ratio(fault)) if KINDS[fault.effect].covariance else work.energy(fault)


def label_of(name: str, kind: str, faults: list[Fault], bare: Work, spiked: bool) -> dict:
    entries = []
    for fault in faults:
        work = reduce(Work.under, (other for other in faults if other is not fault), bare)
        energy, absorbed = strength_of(work, fault), False
        members, share = [fault.effect], None
        if not KINDS[fault.effect].covariance:
            difference = work.difference(fault)
            share = kept_share(work.around, difference)
            absorbed = share < GONE
            if not absorbed:
                members = work.around.inseparable(fault.effect, difference, energy)
        entries.append(
            {
                "effect": fault.effect,
                "theta": [float(v) for v in fault.theta],
                "shape": list(fault.shape),
                "lambda": round(energy, 6),
                "kept_share": share,
                "absorbed": absorbed,
                "class": members,
                "channels": _channels(work, fault),
            }
        )
    return {
        "case": name,
        "kind": "none" if all(e["absorbed"] for e in entries) else kind,
        "effects": sorted(fault.effect for fault in faults),
        "entries": entries,
        "noise_factors": list(bare.factors),
        "outliers": bool(spiked),
        "channel_names": channel_names(bare.around.sensor),
    }


def _channels(work: Work, fault: Fault) -> list[float]:
    """Share of λ on each channel; noise is shared equally by the gyros."""
    if KINDS[fault.effect].covariance:
        return [1 / 3] * 3 + [0.0] * (3 * len(work.around.sensor.triads) - 3)
    difference = work.difference(fault)
    energy = np.maximum(np.sum(work.metric.scaled(difference) * work.metric.clear(difference), axis=0), 0.0)
    return [round(float(v), 6) for v in energy / max(energy.sum(), 1e-300)]


def make(seed: int, number: int, kind: str | None = None, real_noise: bool = False) -> Case:
    """Case `number` of a campaign: the same whatever other cases are made, and by whom."""
    plan, sensor_name, assigned_kind = assigned(seed, number, real_noise)
    return draw(f"case-{number:05d}", plan, sensor_name, kind or assigned_kind, stream(seed, number, 1))


def surroundings(sensor: Sensor, rng: np.random.Generator) -> tuple[tuple[float, ...], Device]:
    """By what the noise of each triad is larger than declared, and the device."""
    wrong, most = rng.random() < WRONG_NOISE, np.log(WRONG_BY)
    factors = np.exp(rng.uniform(-most, most, len(sensor.triads)) * wrong)
    if sensor.real:
        factors = np.array(real.true_factors(sensor.name))
    return tuple(float(factor) for factor in factors), random_device(sensor, rng)


def device_of(seed: int, number: int, sensor: Sensor) -> Device:
    """The device of a case that was made before."""
    return surroundings(sensor, stream(seed, number, 1))[1]


def draw(name: str, plan: str, sensor_name: str, kind: str, rng: np.random.Generator) -> Case:
    """A case of the given composition under the given plan and sensor type."""
    around, sensor = signatures(plan, sensor_name), real.sensor_called(sensor_name)
    factors, device = surroundings(sensor, rng)
    work = Work(around, factors, device)
    faults = _effects(kind, work, rng)
    spiked = rng.random() < WITH_OUTLIERS
    columns = simulate(work, faults, spiked, rng)
    label = label_of(name, kind, faults, work, spiked)
    return Case(name, plan, sensor_name, columns, label, tuple(faults), work.device)


def effects_apart(work: Work, count: int, rng: np.random.Generator, weakest: float) -> list[Fault]:
    """Effects with signatures that can be distinguished from each other, each with a λ from `weakest` on."""
    names = [name for name in CATALOGUE if name != "table_rate_error" and not KINDS[name].covariance]
    names.remove("gyro_bias_random_walk")
    faults: list[Fault] = []
    for _ in range(TRIES):
        energy = float(np.exp(rng.uniform(np.log(weakest), np.log(STRONGEST))))
        left = [name for name in names if name not in {fault.effect for fault in faults}]
        more = one_effect(work, left, energy, rng)
        if not any(overlapping(work, fault, more) for fault in faults):
            faults.append(more)
        if len(faults) == count:
            return faults
    raise RuntimeError("no set of effects that can be distinguished")


def _filtered(values: Array, response: Array) -> Array:
    """Noise (n, channels) behind a filter that keeps the standard deviation of white noise."""
    response = response / np.sqrt(np.sum(response**2))
    return np.column_stack([np.convolve(column, response)[: len(column)] for column in values.T])


ACTS_ON_SAMPLES = ("gyro_saturation", "gyro_saturation_asymmetric", "gyro_quantization", "accel_quantization")
"""Effects whose change of the mean output depends on the noise: a limit cuts the noise on one side, a coarse count rounds it."""
QUANTILES = 200  # of the noise of a sample


def mean_change(
    schedule: Schedule, sensor: Sensor, device: Device, faults: list[Fault], factors: Sequence[float], seed: int = 0
) -> Array:
    """What faults change in the mean of the recorded outputs over the noise, shape (n, channels). Faults that act on samples are averaged
    over the distribution of the noise. factors: true ÷ declared white noise of each triad."""
    changed = change(schedule, sensor, device, faults)
    acting = {fault.effect: fault for fault in faults if fault.effect in ACTS_ON_SAMPLES}
    if not acting:
        return changed
    by_name = {fault.effect: fault for fault in faults}
    clean, free = (clean_output(schedule, sensor, device, by_name, limited) for limited in (True, False))
    draws = real.noise if sensor.real else noise
    scaled = np.repeat(np.asarray(factors, float), 3)
    scaled[:3] *= noise_factor(by_name)
    drawn = np.sort(draws(schedule, sensor, scaled, np.random.default_rng(seed)), axis=0)
    levels = drawn[((np.arange(QUANTILES) + 0.5) / QUANTILES * len(drawn)).astype(int)]
    found = np.zeros_like(clean)
    for level in levels:
        found += coarse(by_name, clipped(by_name, free, free + level)) - clean - level
    return changed + found / QUANTILES


def simulate(
    work: Work, faults: list[Fault], spiked: bool, rng: np.random.Generator, colour: Array | None = None
) -> dict[str, Array]:
    """Columns of the recording, named as in the file. colour: response of a filter of the noise."""
    schedule, sensor = work.around.schedule, work.around.sensor
    by_name = {fault.effect: fault for fault in faults}
    scaled = np.repeat(work.factors, 3)
    scaled[:3] *= noise_factor(by_name)
    scaled[3:] *= accel_noise_factor(by_name)
    draws = real.noise if sensor.real else noise
    added = draws(schedule, sensor, scaled, rng)
    if colour is not None:
        added = _filtered(added, colour)
    if spiked:
        added = outliers(added, sensor.sigma() * scaled, rng)
    values = recorded(sensor, clean_output(schedule, sensor, work.device, by_name, limited=False), by_name, added)
    values = stuck(schedule.time, values, by_name)
    return named(schedule, sensor, values, rng)


def named(schedule: Schedule, sensor: Sensor, values: Array, rng: np.random.Generator) -> dict[str, Array]:
    felt = stimulus(schedule, {})
    angle = np.mod(felt.angle, 360.0) if sensor.wrapped else felt.angle
    warm = felt.temperature + TEMPERATURE_NOISE * rng.standard_normal(len(felt.time))
    columns = {
        "time_s": np.round(schedule.time, 6),
        "table_angle_deg": np.round(angle, 6),
        "temperature_degC": np.round(warm, 3),
    }
    for i, name in enumerate(channel_names(sensor)):
        columns[name] = values[:, i]
    return columns


def channel_names(sensor: Sensor) -> list[str]:
    gyros = [f"gyro_{axis}_deg_per_s" for axis in "xyz"]
    return gyros if sensor.accel is None else gyros + [f"accel_{axis}_m_per_s2" for axis in "xyz"]
