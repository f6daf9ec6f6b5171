"""Real recordings with a known term left out of the nominal model: it is named, its size is right, and the gap closes.

The oracles are what other people and other code say of the same recordings: the estimators' fits, numpy's polynomials, and the bias that
the gyros show at rest before the jig turns.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from planrunner.estimators.accelerometer.gravity_magnitude import fit_magnitude
from planrunner.execution.stopping import StopRequest
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions
from planrunner.gap.hypotheses.candidates import FULL
from planrunner.tasks.closing import Ending, close
from planrunner.tasks.diagnose import diagnose_recorded, recorded_file

PLANS = Path(__file__).parents[2] / "plans"
G = 9.80665


def diagnosed(plan: str, recording: Path, nominal: tuple[str, ...] | None = None) -> Diagnosis:
    options = None if nominal is None else DiagnosisOptions(nominal=nominal)
    return diagnose_recorded(recorded_file(PLANS / f"{plan}.yaml", None, recording), options).diagnosis


def values(found: Diagnosis, effect: str) -> dict[str, tuple[float, float]]:
    return {p.name: (p.value, p.standard_uncertainty) for p in found.parameters if p.effect == effect}


def still_means(path: Path) -> np.ndarray:
    """Mean readings of poses, found apart: runs of two seconds and more in which every second's scatter stays below 0.14 m/s²."""
    table = pyarrow.parquet.read_table(path)
    data = np.column_stack([table[f"accel_{axis}_m_per_s2"].to_numpy() for axis in "xyz"]).astype(float)
    scatter = np.array([data[n : n + 50].std(axis=0, ddof=1).max() for n in range(len(data) - 50)])
    quiet = np.flatnonzero(np.diff(np.concatenate(([0], (scatter < 0.14).astype(int), [0]))))
    runs = [(a + 25, b + 25) for a, b in zip(quiet[::2], quiet[1::2], strict=True) if b - a >= 200]
    return np.array([data[a:b].mean(axis=0) for a, b in runs])


@pytest.mark.parametrize("unit", ["imu0", "imu2"])
def test_scale_and_misalignment_of_a_sensor_tumbled_by_hand(data_root: Path, unit: str) -> None:
    recording = data_root / "mikoff_mpu9150" / f"{unit}.parquet"
    found = diagnosed(f"mpu9150_{unit}", recording)
    assert (found.verdict.kind, found.verdict.effects) == ("pair", ("accel_misalignment", "accel_scale_factor"))
    assert found.closure.resolvable and found.closure.shrinks_by > 0.9
    fit = fit_magnitude(still_means(recording), G).values
    scale, gamma = values(found, "accel_scale_factor"), values(found, "accel_misalignment")
    for axis, expected in zip("xyz", fit[3:6], strict=True):
        value, u = scale[f"k_{axis}"]
        assert value * 1e-6 == pytest.approx(expected - 1, abs=3 * u * 1e-6)
    for pair, expected in zip(("xy", "xz", "yz"), fit[6:], strict=True):
        value, u = gamma[f"gamma_{pair}"]
        assert np.radians(value / 3600) == pytest.approx(expected, abs=3 * np.radians(u / 3600))


def test_simulations_with_what_was_found_agree_with_a_tumble_by_hand(data_root: Path) -> None:
    """No bench can simulate the unknown poses of a hand: the simulations are computed for them."""
    recorded = recorded_file(PLANS / "mpu9150_imu0.yaml", None, data_root / "mikoff_mpu9150" / "imu0.parquet")
    closed = close(recorded, StopRequest())
    assert closed.ending is Ending.NOTHING_LEFT
    assert {name for name, _ in closed.stated} == {"accel_misalignment", "accel_scale_factor"}
    assert closed.rounds[0].comparison.before_sigma > 5
    assert closed.rounds[-1].comparison.after_sigma == pytest.approx(1.0, abs=0.3)


def test_a_whole_nominal_model_leaves_no_gap_in_a_sensor_tumbled_by_hand(data_root: Path) -> None:
    found = diagnosed("mpu9150_imu0", data_root / "mikoff_mpu9150" / "imu0.parquet", FULL)
    assert found.verdict.kind == "none"
    assert found.posterior.probability["none"] > 0.5
    # Nobody knows how it was held: whatever only turns the triad leaves nothing.
    assert {"table_tilt", "table_azimuth", "table_position_error"} <= found.absorbed.keys()


def test_bias_and_scale_of_a_gyro_that_only_turned_one_way(data_root: Path) -> None:
    """At rest it shows (2.2, −5.7, −4.9) °/s; a line through its rates has the slope 0.846 ± 0.005, with equal weights of all rates. One
    way round, asymmetry is scale factor."""
    found = diagnosed("rimu_rate_staircase", data_root / "rimu_jig" / "rate_staircase.parquet")
    assert set(found.verdict.effects) == {"gyro_bias", "gyro_scale_factor"}
    assert found.verdict.kind == "indistinguishable"
    assert set(found.verdict.members) >= {
        "gyro_bias+gyro_scale_factor",
        "gyro_bias+gyro_scale_asymmetry",
        "gyro_bias+table_rate_error",
    }
    bias, scale = values(found, "gyro_bias"), values(found, "gyro_scale_factor")
    assert 1 + scale["k_y"][0] * 1e-6 == pytest.approx(0.846, abs=0.0106)
    for axis, at_rest in zip("xyz", (2.2, -5.7, -4.9), strict=True):
        assert abs(bias[f"bias_{axis}"][0] - at_rest) < abs(at_rest) / 2, "nearer to what rest shows than to no bias"
    assert found.closure.resolvable and found.closure.shrinks_by > 0.8


def test_what_the_jig_does_to_a_gyro_is_in_no_catalogue(data_root: Path) -> None:
    """Steps, a hundred a turn, fold down to near 0 Hz at some rates: with a whole nominal model that is no random walk of the bias."""
    found = diagnosed("rimu_rate_staircase", data_root / "rimu_jig" / "rate_staircase.parquet", FULL)
    assert found.verdict.kind == "unknown"


def test_scale_of_a_tumbled_accelerometer(data_root: Path) -> None:
    found = diagnosed("rimu_pitch_tumble", data_root / "rimu_jig" / "pitch_tumble.parquet")
    assert (found.verdict.kind, found.verdict.effects) == ("effect", ("accel_scale_factor",))
    scale = values(found, "accel_scale_factor")
    assert [1 + scale[f"k_{axis}"][0] * 1e-6 for axis in "xz"] == pytest.approx([0.954, 0.953], abs=0.002)
    # The errors of the jig's angles limit the test, not the noise: a fit of the means leaves u = 700 and 500 ppm.
    assert [scale[f"k_{axis}"][1] for axis in "xz"] == pytest.approx([700, 500], rel=0.6)
    assert found.closure.resolvable and found.closure.shrinks_by > 0.9


def test_slope_of_a_gyro_over_temperature(data_root: Path) -> None:
    """A parabola through the means of the bursts, by numpy; its slope halfway is 0.060, −0.028, 0.003 °/s/K."""
    recording = data_root / "psim_thermal_vacuum" / "TVCtest3_7_20.csv"
    found = diagnosed("psim_gyro_thermal_vacuum", recording)
    assert (found.verdict.kind, found.verdict.effects) == ("effect", ("gyro_bias_temperature",))
    table: Any = pyarrow.csv.read_csv(recording)
    bursts = {
        name: table[name].to_numpy().astype(float).reshape(25, 250).mean(axis=1) for name in table.column_names[4:8]
    }
    celsius = (bursts.pop("temp") - 65536) / 256 + 25
    fitted = values(found, "gyro_bias_temperature")
    halfway = (celsius.min() + celsius.max()) / 2
    for axis, name, known in zip("xyz", bursts, (0.060, -0.028, 0.003), strict=True):
        slope = np.polyval(np.polyder(np.polyfit(celsius, np.degrees(bursts[name]), 2)), halfway)
        value = fitted[f"c1_{axis}"][0] + 2 * fitted[f"c2_{axis}"][0] * (halfway - 25)
        assert value == pytest.approx(slope, abs=0.001)
        assert value == pytest.approx(known, abs=0.003)
    assert found.closure.resolvable and found.closure.shrinks_by > 0.9
