"""A made-up, plausible result for the tests of reports: twelve coefficients of a flexure gyro, nineteen segments."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planrunner.archive.recording import Statistics
from planrunner.base.said import Said
from planrunner.estimators.interface import Coefficient, Design, Estimate, Foresight
from planrunner.estimators.limits import LimitVerdict
from planrunner.estimators.tables import Plot, Role, Table, TableColumn
from planrunner.physics.earth import Site
from planrunner.plan.directions import DIRECTIONS
from planrunner.plan.orientation import in_words
from planrunner.plan.schedule import Rest, Schedule, Segment, Spin
from planrunner.reporting.context import ReportContext, SegmentSummary
from planrunner.uncertainty.influences import Budget, BudgetLine

POSITIONS = {
    "P1": "up north west",
    "P2": "down north east",
    "P3": "north up east",
    "P4": "north down west",
    "P5": "east south down",
    "P6": "south east up",
    "P7": "west south up",
    "P8": "south west down",
    "T1": "north west up",
    "T2": "west south up",
    "T3": "south east up",
    "T4": "east north up",
    "T5": "west up north",
    "T6": "up east north",
    "T7": "east down north",
    "T8": "down west north",
    "V1": "up west south",
    "V2": "west north down",
    "V3": "east up south",
}
NAMES = (
    ("SF_X", 0.20114563, "(deg/h)/(pulse/s)", 3.1e-6, "Scale factor of the X torquer"),
    ("SF_Y", 0.19872216, "(deg/h)/(pulse/s)", 2.9e-6, "Scale factor of the Y torquer"),
    ("epsilon", 3.4127, "arcmin", 0.083, "Torquer X axis to case X axis"),
    ("xi", -1.9713, "arcmin", 0.091, "Torquer Y axis to torquer X axis, from a right angle"),
    ("D_X_F", 4.2713, "deg/h", 0.0112, "Drift independent of acceleration"),
    ("D_X_X", 2.8114, "deg/h/g", 0.0139, "Drift proportional to acceleration along X"),
    ("D_X_Y", -1.0926, "deg/h/g", 0.0139, "Drift proportional to acceleration along Y"),
    ("D_X_Z", 0.30418, "deg/h/g", 0.0139, "Drift proportional to acceleration along Z"),
    ("D_Y_F", -5.0127, "deg/h", 0.0108, "Drift independent of acceleration"),
    ("D_Y_X", 1.1873, "deg/h/g", 0.0131, "Drift proportional to acceleration along X"),
    ("D_Y_Y", 2.7902, "deg/h/g", 0.0131, "Drift proportional to acceleration along Y"),
    ("D_Y_Z", -0.00431, "deg/h/g", 0.0131, "Drift proportional to acceleration along Z"),
)


def attitude(words: str) -> np.ndarray:
    return np.array([DIRECTIONS[word] for word in words.split()], dtype=float)


def schedule() -> Schedule:
    segments, time = [], 0.0
    for index, (label, words) in enumerate(POSITIONS.items()):
        soak = 600.0 if index == 0 else 0.0
        transition = 1500.0 if index == 0 else 11.2
        time += transition + soak + 30
        segments.append(
            Segment(
                index, label, attitude(words), in_words(attitude(words)), Rest(), 120.0, 30.0, soak, 298.15,
                transition=transition, start=time,
            )
        )  # fmt: skip
        time += 120
    return Schedule(tuple(segments), time + 60)


def thermal_schedule() -> Schedule:
    """Three temperatures with fourteen rates or rests each, one of them a ramp."""
    segments: list[Segment] = []
    time = 0.0
    for kelvin in (233.15, 293.15, 333.15):
        for place, degrees in enumerate((0, 300, -300, 150, -150, 60, -60, 20, -20, 10, -10, 1, -1, 0)):
            transition, soak = (2400.0, 3600.0) if place == 0 else (5 + abs(degrees) / 10, 0.0)
            dwell = 60.0 if degrees == 0 else max(30.0, 360.0 / abs(degrees))
            time += transition + soak + 10
            motion = Spin(math.radians(degrees)) if degrees else Rest()
            label = f"rate {degrees:+d} deg/s" if degrees else ("start-zero" if place == 0 else "end-zero")
            segments.append(
                Segment(
                    len(segments),
                    label,
                    np.eye(3),
                    "",
                    motion,
                    dwell,
                    10.0,
                    soak,
                    kelvin,
                    transition=transition,
                    start=time,
                )
            )
            time += dwell
    return Schedule(tuple(segments), time)


def estimate(name: str = "drift", scale: float = 1.0) -> Estimate:
    row, column = np.indices((12, 12))
    mix = np.eye(12) + 0.4 * np.sin(7.0 * row + 3.1 * column * column)
    raw = mix @ mix.T
    sigma = np.array([row[3] for row in NAMES]) * scale
    size = np.sqrt(np.diag(raw))
    covariance = raw / np.outer(size, size) * np.outer(sigma, sigma)
    labels = tuple(POSITIONS)[:8]
    other = Table(
        "Standard uncertainties by either basis",
        (
            TableColumn("Coefficient"),
            TableColumn("Unit"),
            TableColumn("u from the residuals (2 d.o.f.)", Role.STANDARD_UNCERTAINTY),
            TableColumn("u from the noise within segments", Role.STANDARD_UNCERTAINTY),
        ),
        tuple((row[0], row[2], float(f"{row[3] * scale:.2g}"), float(f"{row[3] * scale * 0.37:.2g}")) for row in NAMES),
    )
    residuals = Plot(
        "Residuals per position",
        "position",
        "residual [pulse/s]",
        labels,
        {
            "torquer_x": tuple(0.03 * scale * np.sin(5.0 * np.arange(8))),
            "torquer_y": tuple(0.03 * scale * np.cos(3.0 * np.arange(8))),
        },
        {"torquer_x": (0.013,) * 8, "torquer_y": (0.012,) * 8},
    )
    return Estimate(
        name,
        "flexure_gyro_static",
        tuple(Coefficient(n, v, unit, u * scale, 2.0, Said(text)) for n, v, unit, u, text in NAMES),
        covariance,
        headline=tuple(row[0] for row in NAMES),
        settings={"uncertainty": "residual", "outputs": ["torquer_x", "torquer_y"], "weighting": "equal"},
        tables=(other,),
        plots=(residuals,),
        notes=(Said("The uncertainties rest on the residuals of the fit, with two degrees of freedom an output."),),
        warnings=(),
        segments=labels,
        budgets=budgets() if scale == 1 else (),
    )


def budgets() -> tuple[Budget, ...]:
    """Of D_X_F (headline) and epsilon: combined by hand, u² = 0.0112² + 0.0036² + 0.0008² = 1.3904e-4 (deg/h)², u = 0.011791 deg/h."""
    u = math.sqrt(0.0112**2 + 0.0036**2 + 0.0008**2)
    data = BudgetLine(
        "data", "A", 4.2713, "deg/h", 0.0112, "t", 4.0, 1.0, 0.0112, "scatter of the segments about the model"
    )
    position = BudgetLine(
        "table position", "B", 0.0, "arcsec", 3.0, "rectangular", math.inf, 0.0012, 0.0036,
        "table, asset RT-0042, certificate RT-0042 / 2026-117", count=8, calibrated="2026-03-01",
    )  # fmt: skip
    latitude = BudgetLine(
        "latitude", "B", 39.98, "deg", 0.004, "normal", math.inf, 0.2, 0.0008, "bench site, site survey 2026-1",
        calibrated="2026-02-10",
    )  # fmt: skip
    resolution = BudgetLine(
        "resolution torquer_x",
        "B",
        0.0,
        "pulse/s",
        0.29,
        "rectangular",
        math.inf,
        0.2,
        0.0002,
        "sensor's driver",
        False,
    )
    other = BudgetLine("data", "A", 3.4127, "arcmin", 0.083, "t", 4.0, 1.0, 0.083, "scatter of the segments")
    tilt = BudgetLine("table orthogonality", "B", 0.0, "arcsec", 2.0, "normal", math.inf, 0.0167, 0.0333, "table")
    return (
        Budget("D_X_F", "deg/h", (data, position, latitude, resolution), u, 4.913, 2.59),
        Budget("epsilon", "arcmin", (other, tilt), math.hypot(0.083, 0.0333), 5.39, 2.51),
    )


def courses() -> Plot:
    """Position errors over 24 h, two series of 2000 points."""
    hours = np.linspace(0, 24, 2000)
    still = 3.1 * hours / 24 + 1.4 * (1 - np.cos(2 * math.pi * hours / 1.4067))
    turned = 0.11 * hours / 24 + 0.06 * (1 - np.cos(2 * math.pi * hours / 1.4067))
    return Plot(
        "Position error over time",
        "time [h]",
        "position error [nmi]",
        tuple(hours),
        {"without rotation": tuple(still), "with rotation": tuple(turned)},
        lines=True,
    )


def comparison() -> Estimate:
    table = Table(
        "Residual sum of squares over the verification positions",
        (
            TableColumn("Coefficients from"),
            TableColumn("Output"),
            TableColumn("Residual sum of squares", Role.VALUE, "(deg/h)²"),
            TableColumn("Expected by design", Role.VALUE),
            TableColumn("Ratio to the first", Role.VALUE),
        ),
        (
            ("drift", "X", 0.000412, 0.000507, 1.0),
            ("traditional", "X", 0.000971, 0.000683, 2.357),
            ("drift", "Y", 0.000388, 0.000507, 1.0),
            ("traditional", "Y", 0.000455, 0.000662, 1.173),
        ),
    )
    plot = Plot(
        "Compensated rate left over",
        "position",
        "residual [deg/h]",
        ("V1", "V2", "V3"),
        {"drift": (0.011, -0.014, 0.009), "traditional": (0.021, -0.019, 0.013)},
        {"drift": (0.012, 0.012, 0.012), "traditional": (0.015, 0.015, 0.015)},
    )
    return Estimate(
        "residual", "compensation_residual", (), np.zeros((0, 0)), tables=(table,), plots=(plot, courses()),
        warnings=(Said("Three positions: the measured ratio scatters between 0.17 and 9.1 (5 % to 95 %)."),),
        segments=("V1", "V2", "V3"),
    )  # fmt: skip


def context(**changes: Any) -> ReportContext:
    summaries = []
    for segment in schedule().segments:
        mean = 60 * np.array([math.sin(2.0 * segment.index), math.cos(3.0 * segment.index)])
        statistics = Statistics(
            ("torquer_x", "torquer_y"), 12000, 0, mean, mean - 1, mean + 1, 0.01 * np.eye(2),
            np.array([0.0132, 0.0118]), 32,
            segment.start, segment.start + 119.99, 0.01,
        )  # fmt: skip
        summaries.append(SegmentSummary(segment, statistics, {"torquer_x": "pulse/s", "torquer_y": "pulse/s"}))
    given: dict[str, Any] = {
        "title": "Optimal eight-position calibration of a flexure gyro",
        "description": "Torquer currents at rest in eight positions, beside a traditional set of eight.",
        "run_information": {
            "device_serial": "FG-0417",
            "operator": "demo",
            "work_order": "WO-2291",
            "fixture": "cube 3",
        },
        "bench": {"name": "virtual", "description": "Simulated three-axis table, chamber and flexure gyro"},
        "instruments": {
            "table": {"manufacturer": "planrunner", "model": "virtual table", "serial": "V-1"},
            "chamber": {"manufacturer": "planrunner", "model": "virtual chamber", "serial": "V-2"},
            "sensor": {"model": "virtual flexure gyro", "serial": "FG-0417"},
        },
        "site": Site(math.radians(39.98), 9.80151),
        "segments": tuple(summaries),
        "estimates": (estimate(), estimate("traditional", 1.9), comparison()),
        "limits": (
            LimitVerdict("drift.D_X_F", "within ±5 deg/h", "guarded", "pass", 4.2713, "deg/h", 0.0112, 0.04819, 4.303),
            LimitVerdict(
                "drift.D_Y_F",
                "within ±5 deg/h",
                "guarded",
                "fail",
                -5.0127,
                "deg/h",
                0.0108,
                0.04647,
                4.303,
                "outside by 0.013 deg/h",
            ),
        ),
        "warnings": ("The chamber reached 25.6 degC in P7, 0.1 K beyond its band.",),
        "provenance": {
            "planrunner": "0.1.0",
            "python": "3.12.3",
            "numpy": "2.1.0",
            "plan": "sha256:" + "9f2c4e" * 10 + "aabb",
            "bench": "sha256:" + "07d1f3" * 10 + "ccdd",
            "journal head": "sha256:" + "5be840" * 10 + "eeff",
            "seal": "sha256:" + "1c77a9" * 10 + "0011",
            "analysis": "1",
            "recorded": "2026-03-02T08:11:09Z to 2026-03-02T09:38:53Z",
            "analysed": "2026-03-02T09:38:55Z",
        },
    }
    return ReportContext(**{**given, **changes})


def design() -> Design:
    predicted = tuple(Coefficient(n, v, unit, u, math.inf, Said(text)) for n, v, unit, u, text in NAMES)
    return Design((), foresight=lambda: Foresight(predicted))
