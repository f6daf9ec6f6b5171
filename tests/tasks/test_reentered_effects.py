"""From a finding to the simulation: every effect, with the parameters that a diagnosis states, is in the simulation at the stated size.

The oracle is a least-squares fit of the effect's columns to the difference of two simulations with the same noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planrunner.base import plugins
from planrunner.base.findings import InputError, Mark
from planrunner.error_model.added import NOISE, OF_TRIAD, parameters
from planrunner.error_model.effects.interface import (
    Curved,
    Effect,
    HasAlternatives,
    HasShape,
    OutsideCoefficients,
    PerOrientation,
    Shaped,
    is_whole,
    triad_of,
)
from planrunner.error_model.observed import Observed
from planrunner.error_model.scheduled import everything
from planrunner.execution.stopping import StopRequest
from planrunner.plan import source
from planrunner.tasks import run as running
from planrunner.tasks.check import Document, Sound, check_plan
from planrunner.tasks.diagnose import observe, recorded_run
from planrunner.tasks.simulate import additions_to, with_effects

PLAN = b"""
planrunner: 1
title: A little of everything
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
defaults: {settle: 1 s, dwell: 4 s}
segments:
  - for_each:
      orientation:
        P1: &x {x: up, y: north, z: west}
        P2: {x: down, y: north, z: east}
        P3: &y {x: north, y: up, z: east}
        P4: {x: south, y: down, z: east}
        P5: &z {x: east, y: north, z: up}
        P6: {x: west, y: north, z: down}
  - {orientation: *x, for_each: {rate: "\xc2\xb160 deg/s, 90 deg/s"}, label: "X{rate}"}
  - {orientation: *y, for_each: {rate: "\xc2\xb160 deg/s, 90 deg/s"}, label: "Y{rate}"}
  - {orientation: *z, for_each: {rate: "\xc2\xb160 deg/s, 90 deg/s"}, label: "Z{rate}"}
  - {orientation: *z, motion: {rock: {amplitude: 5 deg, frequency: 1 Hz}}, label: K}
  - {orientation: {from: {x: up, y: north, z: west}, rotate: [y 40 deg, x 30 deg]}, label: O}
  - {orientation: *x, temperature: 45 degC, soak: 2 min, label: W}
  - {orientation: *x, temperature: 45 degC, rate: 60 deg/s, label: WX}
  - {orientation: *y, temperature: 45 degC, rate: 60 deg/s, label: WY}
  - {orientation: *z, temperature: 45 degC, rate: 60 deg/s, label: WZ}
  - {orientation: *y, temperature: {ramp_to: 48 degC}, dwell: 2 min, label: R}
  - {orientation: *z, temperature: 20 degC, soak: 2 min, label: C}
  - {orientation: *x, temperature: 20 degC, supply_voltage: 6 V, ambient_pressure: 900 hPa, rate: 60 deg/s, label: SX}
  - {orientation: *y, temperature: 20 degC, supply_voltage: 6 V, ambient_pressure: 900 hPa, rate: 60 deg/s, label: SY}
  - {orientation: *z, temperature: 20 degC, supply_voltage: 6 V, ambient_pressure: 900 hPa, rate: 60 deg/s, label: SZ}
"""
NOT_POSSIBLE_BEFORE = [
    "earth_rate",
    "table_position_error",
    "gyro_noise_excess",
    "gyro_quantization",
    "table_rate_ripple",
]
DECLARED = ("axis_reversed", "axes_mirrored", "axes_exchanged", "unit_wrong", "table_sense_reversed", "mount_turned")
"""Wrong declarations change an output altogether; `tests/gap/test_declarations.py` adds them to simulations."""
OF_A_REFERENCE = ("reference_latency",)
"""These need a motion that only the recording shows; `tests/estimators/test_motion_not_commanded.py` fits them."""
OTHERS = sorted(
    set(plugins.names(plugins.EFFECTS)) - {*NOT_POSSIBLE_BEFORE, *DECLARED, *OF_A_REFERENCE, "gyro_fold_over"}
)
LARGER = {
    "accel_cross_coupling": 10.0,
    "accel_magnetic_sensitivity": 10.0,
    "gyro_bias_drift": 300.0,
    "site_latitude": 30.0,
    "table_azimuth": 400.0,
}
"""Factors for effects that are small against a count in this short plan."""
BENCH = "virtual_imu_nominal"


def _simulated(bench: bytes, folder: Path) -> Observed:
    sound = check_plan(Document(PLAN, "plan.yaml"), Document(bench, "bench.yaml")).sound()
    run, outcome = running.start(sound, info={}, runs=folder, stop=StopRequest(), durability="flushed", seed=5)
    assert outcome.ok
    return observe(recorded_run(run))[0]


@pytest.fixture(scope="module")
def sound() -> Sound:
    return check_plan(Document(PLAN, "plan.yaml"), BENCH).sound()


@pytest.fixture(scope="module")
def without(sound: Sound, tmp_path_factory: pytest.TempPathFactory) -> Observed:
    return _simulated(sound.bench_bytes, tmp_path_factory.mktemp("without"))


def _stated(effect: Effect, observed: Observed) -> dict[str, tuple[float, str]]:
    """Parameters by the names that a diagnosis gives them, none of natural size: value and unit."""
    if isinstance(effect, OutsideCoefficients) and effect.outside == "gauss-markov":
        return {"tau": (30.0, "s"), "sigma": (0.1, OF_TRIAD[triad_of(effect)])}
    if effect.id == "samples_stuck":
        return {"time": (10.0, "s"), "lasting_gyro_y": (1.5, "s"), "lasting_accel_z": (0.5, "s")}
    if isinstance(effect, OutsideCoefficients) and effect.outside in NOISE:
        unit = OF_TRIAD[triad_of(effect)] + NOISE[effect.outside][1]
        names = {"white": "white_{}", "resolution": "count_{}"}.get(effect.outside)
        if names is None:
            return {"density": (0.01, unit)}
        return {names.format(axis): (0.005 * (place + 1), unit) for place, axis in enumerate("xyz")}
    found = {one.name: (one.natural, one.unit) for one in parameters(effect, observed)}
    shape = effect.shape_name if isinstance(effect, HasShape) else ""
    if isinstance(effect, PerOrientation):
        found = {}
        for number in range(1, 8):
            found |= {f"orientation_{number}_{axis}": (20.0 * number - 75.0, "arcsec") for axis in "xyz"}
    elif effect.id == "earth_rate":
        found = {"share": (300.0, "1")}
    elif effect.id == "table_rate_ripple":
        found["n"] = (2.0, "per turn")
    elif effect.id == "gyro_dead_zone":
        found["d"] = (1.0, "deg/s")
    elif isinstance(effect, OutsideCoefficients):
        found[shape] = (113.0, "Hz")  # appears at 13 Hz
    elif effect.id == "gyro_saturation":
        found["limit"] = (70.0, "deg/s")
    elif effect.id == "gyro_saturation_asymmetric":
        return {"upper": (70.0, "deg/s")}
    for place, name in enumerate(name for name in found if name != shape):
        if effect.id != "earth_rate" and not isinstance(effect, PerOrientation):
            found[name] = (found[name][0] * (1.5 + 0.25 * place) * LARGER.get(effect.id, 1.0), found[name][1])
    return found


def _predicted(effect: Effect, observed: Observed, stated: dict[str, tuple[float, str]]) -> np.ndarray:
    """What the effect changes in the outputs, (N, K), SI, by its columns on the whole recording."""
    out = np.zeros_like(observed.values)
    if isinstance(effect, HasAlternatives):
        (effect,) = (way for way in effect.alternatives if way.shape_name in stated)
    if isinstance(effect, Shaped):
        columns = effect.at(observed, stated[effect.shape_name][0]).columns
    else:
        wanted = stated[effect.shape_name][0] if isinstance(effect, HasShape) else None
        columns = next(one for one in effect.variants(observed) if one.shape == wanted).columns
    if isinstance(effect, Curved):
        columns = effect.around(observed, np.array([stated[c.name][0] * c.factor for c in columns]))[0].columns
    for column in columns:
        size = 1.0 if is_whole(columns) else stated[column.name][0] * column.factor
        size = stated["share"][0] - 1.0 if effect.id == "earth_rate" else size
        here = 1.0 if column.segments is None else column.segments[observed.owner]
        for channel, part in column.parts.items():
            out[:, channel] += size * part * here
    return out


def _check(name: str, sound: Sound, without: Observed, folder: Path) -> None:
    effect: Effect = plugins.load(plugins.EFFECTS, name)()
    stated = _stated(effect, everything(without.site, without.channels, without.sample_rate))
    texts = {key: f"{value:.9g}" + ("" if unit == "1" else f" {unit}") for key, (value, unit) in stated.items()}
    listed = additions_to(sound, [(name, texts)], Mark("here"))
    assert {key: listed[0].values[key] for key in stated} == pytest.approx({key: v for key, (v, _) in stated.items()})
    bench = with_effects(source.decode(sound.bench_bytes, BENCH), listed)
    seen = _simulated(bench.encode(), folder)
    if effect.id == "samples_stuck":
        return _check_stuck(seen, without, {key: value for key, (value, _) in stated.items()})
    if isinstance(effect, OutsideCoefficients) and effect.outside in (*NOISE, "gauss-markov"):
        return _check_noise(effect, seen, without, {key: value for key, (value, _) in stated.items()})
    predicted = _predicted(effect, _with_levels(without), stated)
    change = seen.values - without.values
    shares, tolerances = [], []
    for channel, gives in enumerate(without.channels):
        energy = float(predicted[:, channel] @ predicted[:, channel])
        if energy > 0:
            shares.append(float(predicted[:, channel] @ change[:, channel]) / energy)
            # Two roundings to counts differ by count/√6: 4 standard deviations of their influence, and 2 % for misalignments.
            tolerances.append(0.02 + 4 * gives.resolution / np.sqrt(6 * energy))
    assert min(tolerances) < 0.1, tolerances
    assert np.all(np.abs(np.array(shares) - 1) < tolerances), (shares, tolerances)


def _with_levels(observed: Observed) -> Observed:
    """Effects on the output act on what the sensor gives, which its readings show."""
    from dataclasses import replace

    return replace(observed, fitted=observed.values)


def _check_stuck(seen: Observed, without: Observed, stated: dict[str, float]) -> None:
    for index, channel in enumerate(without.channels):
        since = seen.time - stated["time"]
        inside = np.flatnonzero((since >= 0) & (since < stated.get(f"lasting_{channel.name}", 0.0)))
        others = np.setdiff1d(np.arange(len(since)), inside)
        assert np.array_equal(seen.values[others, index], without.values[others, index])
        assert np.all(seen.values[inside, index] == without.values[inside[0] - 1, index]) if len(inside) else True
        assert len(inside) == {"gyro_y": 75, "accel_z": 25}.get(channel.name, 0)


def _check_noise(effect: OutsideCoefficients, seen: Observed, without: Observed, stated: dict[str, float]) -> None:
    resting = without.owner < 6
    values = np.degrees(seen.values[resting][:, :3])
    if triad_of(effect) == "accel":
        values = seen.values[resting][:, 3:]
    if effect.outside == "white":
        expected = [np.sqrt(stated[f"white_{axis}"] ** 2 * 50.0) for axis in "xyz"]
        own = np.concatenate([part - part.mean(axis=0) for part in np.split(values, 6)])
        assert own.std(axis=0) == pytest.approx(expected, rel=0.1)
    elif effect.outside == "resolution":
        for channel, axis in enumerate("xyz"):
            counts = values[:, channel] / stated[f"count_{axis}"]
            assert np.abs(counts - np.round(counts)).max() < 1e-6
    else:
        part = slice(3, 6) if triad_of(effect) == "accel" else slice(0, 3)
        factor = 1.0 if triad_of(effect) == "accel" else np.degrees(1.0)
        change = factor * (seen.values - without.values)
        assert not np.delete(change, np.r_[part], axis=1).any()
        middles = [change[seen.owner == s, part].mean(axis=0) for s in range(len(seen))]
        if effect.outside == "random walk":
            assert 0.005 < np.diff(middles[:6], axis=0).std() < 0.3  # 0.01 /√s over some ten seconds
        else:
            assert 0.05 < np.std(middles) < 0.2


@pytest.mark.parametrize("name", NOT_POSSIBLE_BEFORE)
def test_what_only_a_diagnosis_states_is_in_the_simulation(
    name: str, sound: Sound, without: Observed, tmp_path: Path
) -> None:
    _check(name, sound, without, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_every_effect_is_in_the_simulation_at_the_stated_size(
    name: str, sound: Sound, without: Observed, tmp_path: Path
) -> None:
    _check(name, sound, without, tmp_path)


@pytest.mark.slow
def test_an_output_that_folds_over_does_not_follow_the_plan(sound: Sound, tmp_path: Path) -> None:
    """90 deg/s beyond a limit of 70 deg/s is read as −50 deg/s, so the recording is not evaluated against the plan."""
    listed = additions_to(sound, [("gyro_fold_over", {"limit": "70 deg/s"})], Mark("here"))
    bench = with_effects(source.decode(sound.bench_bytes, BENCH), listed)
    with pytest.raises(InputError, match="does not follow the plan"):
        _simulated(bench.encode(), tmp_path)
