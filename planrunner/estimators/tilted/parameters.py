"""Declares the plan keys for the scale factors of several axes in one tilted mounting."""

from __future__ import annotations

from planrunner.estimators.tilted.scatter import (
    BASES,
)
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, QuantityOf, Record, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity

THERMOMETER = "sensor_temperature"


class ScaleFactorTiltedParameters(Record):
    """Declares the plan keys of the estimator `scale_factor_tilted`."""

    outputs: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1, single=True),
        "Channels to use; the end of a channel's name gives its axis in `mounting`. By default one channel for every axis.",
        ["gyro_x", "gyro_y", "gyro_z"],
        default_factory=tuple,
    )
    zero: tuple[str, ...] = key(
        ListOf(Text(r"[^\x00-\x1f]{1,80}", "a label, or a pattern with the wildcards * and ?"), minimum=1, single=True),
        "Labels of the segments at rest before and after the rates.",
        ["start-zero", "end-zero"],
        default=("start-zero", "end-zero"),
    )
    earth_rate: str = key(
        Choice(("corrected", "averaged", "ignored")),
        "Treatment of the component of the Earth rate perpendicular to the table's rotation axis. `corrected`: it is computed from "
        "latitude, fixture angles and azimuths; `averaged`: it averages to zero over whole turns, which are then required; `ignored`: "
        "it is neglected. Only `corrected` removes it from F0, the offset of the fitted line at zero rate.",
        "corrected",
        default="corrected",
    )
    rate_unit: str = key(
        Text("", "a unit of angular rate"), "Unit of the table's rate in the results.", "deg/s", default="deg/s"
    )
    rate_uncertainty: Quantity | None = optional(
        QuantityOf("ratio", "not negative"),
        "Relative standard uncertainty of the table's rate, common to all rates; the bench file gives the error of "
        "each rate.",
        "50 ppm",
    )
    uncertainty: str = key(
        Choice(BASES),
        "Basis of the uncertainties: the scatter of the repeats, the scatter of the rates about the line, or "
        "the noise within the segments.",
        "repeats",
        default="repeats",
    )
    reference_temperature: Quantity = key(
        QuantityOf("temperature"),
        "Reference temperature. The scale factor K_x of the x axis (and likewise K_y and K_z) is the scale factor at the "
        "tested temperature nearest to the reference temperature. The temperature coefficients refer to this tested temperature.",
        "20 degC",
        default=parse_quantity("20 degC"),
    )
    temperature: str | None = optional(
        CHANNEL,
        f"Channel with the temperature of the sensor; by default {THERMOMETER} if it is recorded, "
        "otherwise the planned temperatures.",
        THERMOMETER,
    )
    remounting: Quantity = key(
        QuantityOf("time", "not negative"),
        "Time to bring the chamber to room temperature, and to mount and align the sensor once. The report uses it to compare the "
        "duration of this test with that of a test with one mounting per axis.",
        "2 h",
        default=parse_quantity("2 h"),
    )
