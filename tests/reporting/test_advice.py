"""Advice on named effects: the fitted parameters in the sentence, with their uncertainties."""

from __future__ import annotations

from planrunner.error_model.effects.gyro_output import GyroNoiseExcess
from planrunner.error_model.effects.table import TableTilt
from planrunner.error_model.effects.warming import GyroWarmUp
from planrunner.gap.answer.parameters import ParameterEstimate
from planrunner.reporting.advice import advice


def test_a_tilt_is_levelled_by_what_was_found() -> None:
    fitted = [
        ParameterEstimate("table_tilt", "about_east", 2.7312, "arcsec", 0.281),
        ParameterEstimate("table_tilt", "about_north", 0.12, "arcsec", 0.28),
        ParameterEstimate("lever_arm", "r_x", 31.0, "mm", 0.1),
    ]
    made = advice(TableTilt(), fitted)
    assert (made.actor, made.remedy) == ("bench", "Level the table: about_east 2.73 ± 0.28 arcsec.")


def test_without_a_clear_amplitude_the_clearest_is_given() -> None:
    fitted = [ParameterEstimate("table_tilt", name, value, "arcsec", 1.0) for name, value in (("a", 0.4), ("b", -1.2))]
    assert "b −1.2 ± 1.0" in advice(TableTilt(), fitted).remedy.replace("-", "−")


def test_a_shape_comes_first_and_gives_the_waiting_time() -> None:
    """exp(−t ÷ 600 s) falls below a hundredth after 600 s · ln 100 = 46 min."""
    fitted = [ParameterEstimate("gyro_warm_up", f"a_{axis}", 0.05, "deg/s", 0.001) for axis in "xyzuv"]
    fitted.append(ParameterEstimate("gyro_warm_up", "tau", 600.0, "s", 20.0))
    remedy = advice(GyroWarmUp(), fitted).remedy
    assert "46 min" in remedy
    assert remedy.index("tau 600 ± 20 s") < remedy.index("a_x")
    assert "and 2 more" in remedy


def test_a_parameter_without_uncertainty_is_given_alone() -> None:
    fitted = [ParameterEstimate("gyro_noise_excess", "white_x", 0.004, "deg/s*sqrt(s)", 0.0)]
    assert "white_x 0.004 deg/s*sqrt(s)" in advice(GyroNoiseExcess(), fitted).remedy.replace("0.004000000", "0.004")
