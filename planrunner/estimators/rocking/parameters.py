"""Declares the plan keys of the estimator for rocking drifts."""

from __future__ import annotations

from typing import Any

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.parameters import QuantityLike
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, Number, QuantityOf, Record, RecordOf, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity


def _angle(description: str, example: str) -> Any:
    return key(QuantityOf("angle", uncertain=True), description, example, default=parse_quantity("0 arcsec"))


class Installation(Record):
    """Installation angles of the accelerometers. Each angle is a right-handed rotation of an accelerometer's input axis about
    another axis of the element."""

    xz: Quantity = _angle("Q_xz, x accelerometer about z.", "12 arcsec ± 2 arcsec")
    xy: Quantity = _angle("Q_xy, x accelerometer about y.", "-8 arcsec ± 2 arcsec")
    yz: Quantity = _angle("Q_yz, y accelerometer about z.", "5 arcsec ± 2 arcsec")
    yx: Quantity = _angle("Q_yx, y accelerometer about x.", "9 arcsec ± 2 arcsec")
    zy: Quantity = _angle("Q_zy, z accelerometer about y.", "-3 arcsec ± 2 arcsec")
    zx: Quantity = _angle("Q_zx, z accelerometer about x.", "14 arcsec ± 2 arcsec")

    def stated(self) -> dict[str, Quantity]:
        """Returns the stated angles as a mapping from name to quantity, in the order in which `RockingConditions` expects them."""
        return {"xz": self.xz, "xy": self.xy, "yz": self.yz, "yx": self.yx, "zy": self.zy, "zx": self.zx}

    def angles(self) -> Array:
        """Returns the stated angles [rad], shape (6,), in the order of `stated`."""
        return np.array([one.value for one in self.stated().values()])


def _channels(description: str, names: tuple[str, ...], least: int) -> Any:
    kind = ListOf(CHANNEL, minimum=least, maximum=3)
    return key(kind, description, list(names), default=names)


class RockingDriftParameters(Record):
    """Declares the plan keys of the estimator `rocking_drift`."""

    release: Quantity = key(
        QuantityOf("time", "positive"),
        "t0, time from the beginning of the record to the first window. Before this time, the stabilised element "
        "of the platform must have left the dead zone of its levelling loop.",
        "60 s",
        default=parse_quantity("60 s"),
    )
    window: Quantity = key(
        QuantityOf("time", "positive"),
        "Length Δt of both windows.",
        "2 s",
        default=parse_quantity("2 s"),
    )
    second_window: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "t1, time from the beginning of the record to the second window. By default, the second window ends "
        "at the end of the shortest record.",
        "590 s",
    )
    released_before: Quantity | None = optional(
        QuantityOf("time", "not negative"),
        "Time from the release of the element to the beginning of each record, for `azimuth: nominal`; the default "
        "is the time that the run recorded. A recording that is played back does not contain it.",
        "5 s",
    )
    cutoff: Quantity = key(
        QuantityOf("frequency", "positive"),
        "Cut-off of the zero-phase low-pass filter, below the rocking frequency.",
        "0.05 Hz",
        default=parse_quantity("0.05 Hz"),
    )
    installation_angles: Installation = key(
        RecordOf(Installation),
        "Installation angles of the accelerometers, as measured optically.",
        {"xz": "12 arcsec", "xy": "-8 arcsec"},
        default_factory=Installation,
    )
    rotation_order: str = key(
        Choice(("xzy", "zxy")),
        "Order of the rotations from the site frame to the element frame with y up: R_x·R_z·R_y or R_z·R_x·R_y; for the "
        "other orientations, see docs/platform-rocking.md.",
        "xzy",
        default="xzy",
    )
    azimuth: str = key(
        Choice(("encoders", "nominal")),
        "Source of the element's azimuth at t0: ring and gimbal encoders, or the planned orientation "
        "rotated with the Earth.",
        "encoders",
        default="encoders",
    )
    azimuth_uncertainty: Quantity | None = optional(
        QuantityOf("angle", "not negative"),
        "Standard uncertainty of the element's azimuth at t0 in one run; by default, with encoders, the table's position uncertainty.",
        "7 arcsec",
    )
    accelerometer_stability: Quantity | None = optional(
        QuantityOf("acceleration", "not negative"),
        "Standard uncertainty of the change of an accelerometer's bias from the first window to the second.",
        "10 ug",
    )
    drift_repeatability: Quantity | None = optional(
        QuantityOf("angular rate", "not negative"),
        "Standard uncertainty of the difference between the element's drift in one run and its mean drift over all runs.",
        "0.002 deg/h",
    )
    random_walk: Quantity | None = optional(
        QuantityLike("deg/sqrt(h)", "not negative"), "Random walk of the element's attitude.", "0.0004 deg/sqrt(h)"
    )
    smallest_drift: Quantity = key(
        QuantityOf("angular rate", "positive"),
        "Smallest drift to resolve. `check` reports the time in which this drift changes the reading of an accelerometer by one count.",
        "0.003 deg/h",
        default=parse_quantity("0.003 deg/h"),
    )
    accelerometers: tuple[str, ...] = _channels(
        "Channels of the accelerometers along x, y, z.", ("accel_x", "accel_y", "accel_z"), 3
    )
    gimbals: tuple[str, ...] = _channels(
        "Channels of the gimbal angles, outermost first.", ("gimbal_outer", "gimbal_middle", "gimbal_inner"), 3
    )
    gimbal_axes: tuple[str, ...] = key(
        ListOf(Choice(("x", "y", "z")), minimum=3, maximum=3),
        "Axis about which each gimbal turns, outermost gimbal first. The letter names an axis of the part that carries the gimbal.",
        ["x", "y", "z"],
        default=("x", "y", "z"),
    )
    rings: tuple[str, ...] = _channels(
        "Channels of the table's ring angles, outermost first.", ("table_outer", "table_middle", "table_inner"), 1
    )
    pairings: int = key(
        Number(1, 100_000, integer=True),
        "Largest number of pairs of a static and a dynamic run that are compared in each orientation. If there are more "
        "pairs, this number of them is drawn at random.",
        200,
        default=200,
    )
    pairing_seed: int = key(Number(0, 2**31, integer=True), "Seed of the draw.", 1, default=1)

    def second(self, end: float) -> float:
        """Returns the time t1 [s] at which the second window begins. `end`: the time at which the records end, s."""
        return end - self.window.value if self.second_window is None else self.second_window.value
