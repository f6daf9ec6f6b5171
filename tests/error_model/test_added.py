"""Effects added to outputs, against formulas worked out here; what is stated of them, right and wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planrunner.base.findings import InputError, Mark
from planrunner.error_model.added import Addition, added, addition
from planrunner.error_model.effects.thermal_lag import GyroBiasTemperatureLagged, lag
from planrunner.error_model.observed import Observed, TemperatureCourse, channel_of
from planrunner.error_model.scheduled import everything, scheduled
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Rest, Segment, Spin

HERE = Mark("here")
SITE = Site(math.radians(40.0), 9.8, magnetic_field=(0.0, 0.55, -0.83))
DEG = math.pi / 180
RATE = 50.0
CHANNELS = [channel_of(f"gyro_{a}", "deg/s", 1e-3, 0.0, 1e-3) for a in "xyz"]
CHANNELS += [channel_of(f"accel_{a}", "m/s^2", 5e-4, 0.0, 2e-4) for a in "xyz"]


def _seen(attitude: np.ndarray, rate: float = 0.0, kelvin: float = 298.15) -> Observed:
    motion = Spin(rate * DEG) if rate else Rest()
    segment = Segment(0, "S", attitude, "", motion, 10.0, temperature=kelvin, start=600.0)
    return scheduled([segment], SITE, [c for c in CHANNELS if c], RATE)


def _stated(name: str, **values: str) -> Addition:
    return addition(name, values, everything(SITE, [c for c in CHANNELS if c], RATE), HERE)


def test_a_sensitivity_to_gravity_adds_what_the_axis_carries() -> None:
    up_y = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    seen = _seen(up_y)
    out = added(seen, np.zeros_like(seen.values), [_stated("gyro_g_sensitivity", K_x_y="0.01 deg/s/g")], 1)
    # K_x_y: output y by the force along x; here y carries gravity, so nothing; K_y_x gives output x.
    assert out == pytest.approx(np.zeros_like(out), abs=1e-12)
    out = added(seen, np.zeros_like(seen.values), [_stated("gyro_g_sensitivity", K_y_x="36 deg/h/g")], 1)
    assert out[:, 0] == pytest.approx(0.01 * DEG * 9.8 / 9.80665)
    assert not out[:, 1:].any()


def test_warming_up_is_stated_at_power_on() -> None:
    seen = _seen(np.eye(3))
    out = added(seen, np.zeros_like(seen.values), [_stated("gyro_warm_up", tau="10 min", a_z="0.5 deg/s")], 1)
    assert out[0, 2] == pytest.approx(0.5 * DEG * math.exp(-1.0))
    assert out[-1, 2] == pytest.approx(0.5 * DEG * math.exp(-(600 + 7 / RATE) / 600))


def test_stages_follow_one_another() -> None:
    """A limit clips what a sensitivity has added before, in whatever order they are listed."""
    seen = _seen(np.eye(3), rate=100.0)
    levels = seen.nominal_output.copy()
    limit, slope = _stated("gyro_saturation", limit="100.001 deg/s"), _stated("gyro_scale_asymmetry", k_z="100 ppm")
    for listed in ([limit, slope], [slope, limit]):
        out = added(seen, levels, listed, 1)
        assert np.degrees(out[:, 2]) == pytest.approx(100.001)


def test_a_dead_zone_acts_on_the_sensors_own_output() -> None:
    seen = _seen(np.eye(3))
    levels = np.zeros_like(seen.values)
    levels[:, 0], levels[:, 1] = 0.05 * DEG, 0.3 * DEG
    out = added(seen, levels, [_stated("gyro_dead_zone", d="0.1 deg/s")], 1)
    assert out[:, 0] == pytest.approx(0.0, abs=1e-15)
    assert np.degrees(out[:, 1]) == pytest.approx(math.sqrt(0.3**2 - 0.1**2))


def test_one_limit_or_both_of_different_size_are_added() -> None:
    levels = np.zeros((8, 6))
    levels[:, 0], levels[:, 1] = 50 * DEG, -50 * DEG
    for stated, expected in (
        ({"upper": "40 deg/s"}, (40, -50)),
        ({"upper": "40 deg/s", "lower": "30 deg/s"}, (40, -30)),
    ):
        out = added(_seen(np.eye(3)), levels, [_stated("gyro_saturation_asymmetric", **stated)], 1)
        assert np.degrees(out[:, :2]) == pytest.approx(np.tile(expected, (8, 1)))


def test_an_orientation_has_the_same_error_whenever_it_is_taken() -> None:
    size = _stated("table_position_error", size="30 arcsec")
    there, turned = np.eye(3), np.diag([1.0, -1.0, -1.0])
    found = [added(_seen(a), np.zeros((8, 6)), [size], 7) for a in (there, turned, there)]
    assert found[0] == pytest.approx(found[2])
    assert not np.allclose(found[0], found[1])
    # Upright, two small angles tip gravity into x and y: some 30 arcsec times g each.
    spread = [added(_seen(there), np.zeros((8, 6)), [size], seed)[0, 3:5] for seed in range(200)]
    assert np.std(spread) == pytest.approx(30 / 3600 * DEG * 9.8, rel=0.15)


@pytest.mark.parametrize(
    ("name", "values", "code", "words"),
    [
        ("gyro_warmup", {}, "effect-unknown", "gyro_warm_up"),
        ("gyro_warm_up", {"taw": "600 s"}, "effect-parameter", "tau"),
        ("gyro_warm_up", {"tau": "600 K"}, "effect-value", "600 K"),
        ("gyro_warm_up", {"tau": "soon"}, "effect-value", "soon"),
        ("table_tilt", {"": "nan"}, "effect-value", "nan"),
        ("gyro_bias_gauss_markov", {"tau": "0 s"}, "effect-value", "is above zero, such as '300 s'"),
        ("gyro_bias_gauss_markov", {"tau": "-5 s"}, "effect-value", "'-5 s'"),
        ("gyro_bias_gauss_markov", {"sigma": "-1 deg/s"}, "effect-value", "zero or above"),
        ("gyro_line_interference", {"frequency": "-3 Hz"}, "effect-value", "'-3 Hz'"),
        ("gyro_warm_up", {"tau": "0 min"}, "effect-value", "above zero"),
        ("gyro_saturation", {"limit": "-100 deg/s"}, "effect-value", "above zero"),
        ("gyro_saturation_asymmetric", {"upper": "-100 deg/s"}, "effect-value", "zero or above"),
        ("gyro_noise_excess", {"white_x": "-1"}, "effect-value", "zero or above"),
        ("samples_stuck", {"time": "-5 s", "lasting": "3 s"}, "effect-value", "'-5 s'"),
        ("samples_stuck", {"lasting_gyro_x": "-3 s"}, "effect-value", "zero or above"),
        ("table_position_error", {"size": "-20 arcsec"}, "effect-value", "zero or above"),
    ],
)
def test_what_is_wrong_is_said(name: str, values: dict[str, str], code: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        _stated(name, **values) if "" not in values else addition(
            name, values, everything(SITE, [c for c in CHANNELS if c], RATE), HERE
        )
    (finding,) = caught.value.findings
    assert finding.code == code
    assert words in f"{finding.message} {finding.hint}"


def test_amplitudes_may_be_negative_and_durations_zero() -> None:
    assert _stated("table_tilt", about_east="-3 arcsec").values["about_east"] == -3.0
    assert _stated("table_position_error", size="0", orientation_1_x="-3").values["orientation_1_x"] == -3.0
    assert _stated("samples_stuck", time="0 s", lasting="0 s").values == {"time": 0.0, "lasting": 0.0}


def test_a_delay_may_be_negative() -> None:
    """A diagnosis also finds data that are early; `close` then adds this delay."""
    assert _stated("time_latency", delay="-2 ms").values == {"delay": -2e-3}
    assert _stated("gyro_saturation_asymmetric", upper="0").values["upper"] == 0.0


def test_what_cannot_act_is_refused() -> None:
    gyros = [c for c in CHANNELS if c and c.kind == "gyro"]
    with pytest.raises(InputError, match="cannot act"):
        addition("lever_arm", {}, everything(SITE, gyros, RATE), HERE)


def test_units_of_one_dimension_are_converted() -> None:
    (east, north) = _stated("table_tilt", about_east="1 arcmin").values.values()
    assert east == pytest.approx(60.0) and north == 0.0
    assert _stated("table_tilt").values["about_east"] == pytest.approx(60.0)


def test_what_is_remembered_of_a_temperature_has_the_same_effect_and_does_not_grow() -> None:
    """A sensor that warms up by a kelvin in a second, in ten blocks of a second and in one: what a block remembers takes the place of all
    samples before it."""
    tau, effect = 7.0, GyroBiasTemperatureLagged()
    past: dict[float, tuple[TemperatureCourse, ...]] = {}

    def ramp(first: int, count: int) -> Observed:
        since = np.arange(first, first + count) / RATE
        bounds = np.array([0, count])
        return replace(
            _seen(np.eye(3)), time=600 + since, temperature=20 + since, temperature_rate=np.ones(count), bounds=bounds, past=past
        )  # fmt: skip

    whole = lag(ramp(0, 500), tau)
    assert whole[-1] == pytest.approx(-tau * (1 - math.exp(-499 / RATE / tau)), rel=1e-3)
    for first in range(0, 500, 50):
        block = ramp(first, 50)
        assert lag(block, tau) == pytest.approx(whole[first : first + 50], rel=1e-3, abs=1e-3)
        past = {tau: effect.remembered(block, tau)}
        assert sum(len(course.time) for course in past[tau]) == 2
