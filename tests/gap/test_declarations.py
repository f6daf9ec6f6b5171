"""Wrong declarations are named and corrected; worlds without them name none. The mistakes are made by hand, not by the catalogue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.base.findings import Mark
from planrunner.error_model.added import added, addition
from planrunner.error_model.observed import Observed
from planrunner.gap.hypotheses.declarations import WrongDeclaration, corrected
from planrunner.plan.schedule import RecordedMotion, Rest, Spin
from tests.gap.turntable import DEG, Array, G, kept, record


def _values(observed: Observed, change: Callable[[Array], None]) -> Observed:
    values = observed.values.copy()
    change(values)
    return replace(observed, values=values)


def _multiplied(observed: Observed, channels: tuple[int, ...], factor: float) -> Observed:
    def change(values: Array) -> None:
        values[:, channels] *= factor

    return _values(observed, change)


def _moved(observed: Observed, order: tuple[int, ...]) -> Observed:
    return replace(observed, values=observed.values[:, order])


def _declared_turned(observed: Observed, turn: Array) -> Observed:
    """The plan states another attitude: the sensor sees `turn` of what the plan expects."""
    return replace(observed, attitude=turn.T @ observed.attitude)


def _declared_backward(observed: Observed) -> Observed:
    motions = tuple(Spin(-m.rate, m.about) if isinstance(m, Spin) else m for m in observed.motions)
    return replace(
        observed, motions=motions, angle=-observed.angle, rate=-observed.rate, acceleration=-observed.acceleration
    )


MISTAKES: dict[str, tuple[Callable[[Observed], Observed], str, dict[str, float]]] = {
    "sign of a gyro": (lambda o: _multiplied(o, (1,), -1.0), "axis_reversed", {"gyro_y": 1.0}),
    "sign of an accelerometer": (lambda o: _multiplied(o, (5,), -1.0), "axis_reversed", {"accel_z": 1.0}),
    "signs of two accelerometers": (
        lambda o: _multiplied(o, (3, 4), -1.0), "axis_reversed", {"accel_x": 1.0, "accel_y": 1.0},
    ),
    "left-handed": (lambda o: _multiplied(o, (0, 3), -1.0), "axes_mirrored", {"mirrored_x": 1.0}),
    "two columns": (lambda o: _moved(o, (1, 0, 2, 3, 4, 5)), "axes_exchanged", {"gyro_xy": 1.0}),
    "three columns": (lambda o: _moved(o, (0, 1, 2, 4, 5, 3)), "axes_exchanged", {"accel_xyz": 1.0}),
    "rad for deg": (
        lambda o: _multiplied(o, (0, 1, 2), DEG),
        "unit_wrong", {f"excess_gyro_{axis}": DEG - 1 for axis in "xyz"},
    ),
    "deg for rad, one axis": (lambda o: _multiplied(o, (2,), 1 / DEG), "unit_wrong", {"excess_gyro_z": 1 / DEG - 1}),
    "per hour": (
        lambda o: _multiplied(o, (0, 1, 2), 3600.0), "unit_wrong", {f"excess_gyro_{axis}": 3599.0 for axis in "xyz"},
    ),
    "g for m/s²": (
        lambda o: _multiplied(o, (3, 4, 5), 1 / 9.80665),
        "unit_wrong", {f"excess_accel_{axis}": 1 / 9.80665 - 1 for axis in "xyz"},
    ),
    "mg for g": (lambda o: _multiplied(o, (4,), 1000.0), "unit_wrong", {"excess_accel_y": 999.0}),
    "half the range": (lambda o: _multiplied(o, (0,), 2.0), "unit_wrong", {"excess_gyro_x": 1.0}),
    "turned a quarter": (
        lambda o: _declared_turned(o, np.round(Rotation.from_euler("z", 90, degrees=True).as_matrix())),
        "mount_turned", {"about_x": 0.0, "about_y": 0.0, "about_z": -90.0},
    ),
    "turned in a corner": (
        lambda o: _declared_turned(o, np.roll(np.eye(3), 1, axis=1)),
        # x lies along the planned y, y along z, z along x: +120 deg about the diagonal
        "mount_turned", {f"about_{axis}": 120 / np.sqrt(3) for axis in "xyz"},
    ),
    "sense of the table": (_declared_backward, "table_sense_reversed", {"share": 1.0}),
}  # fmt: skip


def _found(observed: Observed) -> list[WrongDeclaration]:
    return corrected(observed)[1]


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_with_its_size_and_corrected(name: str) -> None:
    make, effect, parameters = MISTAKES[name]
    sound = record(seed=5)
    better, (found,) = corrected(make(sound))
    assert found.effect == effect
    assert dict(found.parameters) == pytest.approx(parameters, rel=1e-6, abs=1e-5)
    expected = sound if effect != "mount_turned" else make(sound)
    if effect == "mount_turned":
        seen = np.array([(better.values[part, 3:]).mean(axis=0) for part in better.segments()])
        applied = np.array([expected.force[part].mean(axis=0) for part in expected.segments()])
        assert np.abs(seen - applied).max() < 0.1
    else:
        assert np.allclose(better.values, expected.values) and np.allclose(better.rate, expected.rate)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_simulation_with_the_parameters_found_shows_the_same_recording(name: str) -> None:
    """The mistake made by hand, and the same mistake added to a simulation."""
    make = MISTAKES[name][0]
    made = make(record(seed=5))
    (found,) = _found(made)
    better, _ = corrected(made)
    stated = {key: repr(value) for key, value in found.parameters.items()}
    item = addition(found.effect, stated, made, Mark("simulation"))
    if found.effect in ("table_sense_reversed", "mount_turned"):
        ideal = [made.omega, made.force]
        again = added(made, np.hstack(ideal), [item], 1)
        assert np.abs(again - made.values).max() < 0.03 * np.abs(made.values).max() + 0.03
    else:
        assert np.allclose(added(better, better.values, [item], 1), made.values)


def test_two_mistakes_at_once_are_both_named() -> None:
    found = _found(_multiplied(_multiplied(record(seed=6), (1,), -1.0), (3, 4, 5), 1 / 9.80665))
    assert [one.effect for one in found] == ["axis_reversed", "unit_wrong"]


def test_the_sense_of_the_table_and_the_signs_of_the_gyros_are_distinguished_where_the_earth_rate_is_seen() -> None:
    """Both reverse the rates about the vertical, but only reversed signs reverse the rotation of the Earth."""
    quiet, noisy = record(seed=7), record(seed=7, noise=100.0)
    for sound, alternative in ((quiet, ""), (noisy, "signs of all gyros")):
        (found,) = _found(_declared_backward(sound))
        assert found.effect == "table_sense_reversed" and alternative in found.alternative
    assert not _found(noisy)
    (found,) = _found(_multiplied(quiet, (0, 1, 2), -1.0))
    assert (found.effect, len(found.parameters)) == ("axis_reversed", 3)


def test_means_that_follow_no_declaration_are_left_as_they_are() -> None:
    deaf = _values(record(seed=8), lambda values: values[:, 0].fill(0.0))
    same, found = corrected(deaf)
    assert same is deaf and not found
    rest = record(seed=9)
    few = kept(rest, [k for k, motion in enumerate(rest.motions) if isinstance(motion, Rest)])
    assert not _found(few)


def _fault(number: int) -> Callable[[Observed, Array, Array, np.random.Generator], tuple[Array | float, Array | float]]:
    """A strong error of the sensor, but none of declaration."""

    def fault(
        observed: Observed, omega: Array, force: Array, draw: np.random.Generator
    ) -> tuple[Array | float, Array | float]:
        size = float(draw.uniform(0.2, 1.0))
        match number % 6:
            case 0:
                return size * DEG * force / G, 0.0
            case 1:
                return 0.1 * size * np.abs(omega), 0.05 * size * force**2 / G
            case 2:
                return 0.15 * size * omega, 0.15 * size * force
            case 3:
                return omega @ draw.normal(0, 0.05, (3, 3)), force @ draw.normal(0, 0.05, (3, 3))
            case 4:
                return draw.normal(0, 0.5 * DEG, (len(observed), 3))[observed.owner], 0.3 * draw.normal(0, 1, 3)
        return 0.0, 0.0

    return fault


@pytest.mark.slow
def test_errors_of_the_sensor_are_no_wrong_declarations() -> None:
    assert [seed for seed in range(60) if _found(record(seed=1000 + seed, fault=_fault(seed)))] == []


def to_and_fro(segments: int = 6, sampling: float = 20.0) -> Observed:
    """A gyro triad that an arm swings about the vertical, z up, with an encoder. Every segment holds whole periods, so that its mean rate
    is nearly zero."""
    sound = record(seed=5)
    n = int(20.0 * sampling)
    since = np.arange(n) / sampling
    pulsation = 2 * np.pi * 0.4
    rate = np.tile(np.radians(40) * np.cos(pulsation * since), segments)
    angle = np.tile(np.radians(40) / pulsation * np.sin(pulsation * since), segments)
    acceleration = np.tile(-np.radians(40) * pulsation * np.sin(pulsation * since), segments)
    time = np.concatenate([since + 30.0 * index for index in range(segments)])
    flat = np.zeros(segments * n)
    shell = replace(
        sound,
        channels=sound.channels[:3],
        labels=tuple(f"part_{index}" for index in range(segments)),
        motions=(RecordedMotion(angle="encoder"),) * segments,
        attitude=np.tile(np.eye(3), (segments, 1, 1)),
        bounds=np.arange(segments + 1) * n,
        time=time, angle=angle, rate=rate, acceleration=acceleration,
        temperature=flat + 25.0, temperature_rate=flat, last_change=np.zeros(segments), values=np.zeros((segments * n, 3)),
    )  # fmt: skip
    noise = np.random.default_rng(8).normal(0.0, 0.1 * DEG, (segments * n, 3))
    return replace(shell, values=shell.omega * [1.0, 1.0, 1.005] + 0.3 * DEG + noise)


def test_a_sign_is_found_in_a_recorded_motionto_and_fro() -> None:
    sound = to_and_fro()
    assert not _found(sound)
    better, (found,) = corrected(_multiplied(sound, (0, 1, 2), -1.0))
    assert found.effect == "table_sense_reversed"
    assert "the sign of the recorded angle" in found.alternative
    assert np.allclose(better.rate, -sound.rate)


@pytest.mark.parametrize("factor", [DEG, 1 / DEG, 60.0])
def test_a_unit_is_found_in_a_recorded_motionto_and_fro(factor: float) -> None:
    sound = to_and_fro()
    better, (found,) = corrected(_multiplied(sound, (2,), factor))
    assert found.effect == "unit_wrong"
    assert found.parameters == pytest.approx({"excess_gyro_z": factor - 1}, rel=1e-9)
    assert np.allclose(better.values, sound.values)


def test_a_delay_of_a_recorded_motion_is_no_declaration() -> None:
    sound = to_and_fro()
    late = replace(sound, values=np.roll(sound.values, 8, axis=0))  # 0.4 s
    assert not _found(late)


@pytest.mark.parametrize("small", [0.004, DEG])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_columns_are_exchanged_though_the_table_turns_about_one_axis_only(small: float, sign: float) -> None:
    """A table about sensor z. The gyro across it shows a small part of the rate, which may resemble a factor between units."""
    whole = record()
    level = [k for k, frame in enumerate(whole.attitude) if np.allclose(frame, np.eye(3))]
    observed = kept(whole, level)
    assert observed.rate.any()

    def change(values: Array) -> None:
        values[:, 0] += small * values[:, 2]
        values[:, [0, 2]] = values[:, [2, 0]] * [sign, 1.0]

    found = _found(_values(observed, change))
    assert found[0].effect == "axes_exchanged"
    assert dict(found[0].parameters) == {"gyro_xz": 1.0} or dict(found[0].parameters) == {"gyro_zx": 1.0}
    assert [one.effect for one in found[1:]] == ([] if sign > 0 else ["axis_reversed"])
