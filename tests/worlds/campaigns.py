"""Tests of known devices: the plan and bench that planrunner is given, the steps that are really carried out, and the device under test.

A device is drawn anew for each recording, so that coverage is of many devices and not of one. Its outputs follow from formulas that are
written here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tests.worlds import temperature_cycles
from tests.worlds.campaign import SITE, TABLE, Campaign
from tests.worlds.felt import STANDARD_GRAVITY, UPWARD, Felt, Step
from tests.worlds.navigation import figures, navigated
from tests.worlds.platform import AMPLITUDE, FIRST, FREQUENCY, PHASES, RINGS, ROCKED, SECOND, SETTLE, Platform, Sizes

Array = NDArray[np.float64]


_ROCKING = (
    f"{{rock: {{amplitude: {AMPLITUDE} deg, frequency: {FREQUENCY} Hz, phases: [{', '.join(f'{one} deg' for one in PHASES)}]}}, "
    f"for: {ROCKED} s}}"
)


def _plan(steps: Sequence[Step], head: str, estimates: str) -> str:
    lines = []
    for step in steps:
        axes = ", ".join(f"{name}: {word}" for name, word in zip("xyz", step.axes.split(), strict=True))
        rate = f", rate: {step.rate} deg/s" if step.rate else ""
        rate = f", motion: {_cycle(step)}" if step.moves else rate
        rate = f", motion: {_ROCKING}" if step.rocks else rate
        rate += f", mode: {step.mode}" if step.mode else ""
        rate += f", supply_voltage: {step.volts} V" if step.volts else ""
        rate += f", ambient_pressure: {step.hectopascals} hPa" if step.hectopascals else ""
        lines.append(f"  - {{label: {step.label}, orientation: {{{axes}}}, dwell: {step.dwell} s{rate}}}")
    return "\n".join(["planrunner: 1", head, "segments:", *lines, "estimates:", estimates, ""])


def _cycle(step: Step) -> str:
    """The motion as a plan has it, with positions at quarters of a turn."""
    at, moves = 0.0, []
    for turn in step.moves:
        before, at = at, (at + turn) % 360
        moves.append(f"{'ABCD'[round(before / 90)]} {turn:+g} {'ABCD'[round(at / 90)]}")
    positions = ", ".join(f"{name}: {90 * k} deg" for k, name in enumerate("ABCD"))
    turning = f"moves: [{', '.join(moves)}], turn_rate: {step.rate:g} deg/s, stop: {step.stop:g} s"
    return f"{{cycle: {{{positions}}}, {turning}}}"


_OF_THE_TABLE = ("positions 5 arcsec, stated", "rates 10 ppm, stated", "positions and rates anew at each step")
"""Worlds in which the table is wrong."""
_ANEW = _OF_THE_TABLE[-1:]
"""Says nothing more where no position and no rate is repeated."""


# Eight positions of a flexure gyro ------------------------------------------------------------------------------------

EIGHT = (
    "up north west",
    "down north east",
    "north up east",
    "north down west",
    "east south down",
    "south east up",
    "west south up",
    "south west down",
)
_EIGHT_STEPS = tuple(Step(f"P{number}", axes, 120.0) for number, axes in enumerate(EIGHT, start=1))


class FlexureGyro:
    """i_x = [cos(ε+ξ)·y + sin(ε+ξ)·x]/(SF_Y·cos ξ), i_y = [−sin ε·y + cos ε·x]/(SF_X·cos ξ), in pulse/s, with y = ω_Y + D(X) and
    x = ω_X + D(Y) in deg/h, and D = D_F + D_X·a_X + D_Y·a_Y + D_Z·a_Z with a in g."""

    def __init__(self, draw: np.random.Generator) -> None:
        self.truth: Mapping[str, float] = {
            "SF_X": 0.2 * (1 + 0.02 * draw.standard_normal()),
            "SF_Y": 0.2 * (1 + 0.02 * draw.standard_normal()),
            "epsilon": 10 * draw.standard_normal(),
            "xi": 10 * draw.standard_normal(),
        } | {f"D_{axis}_{kind}": 2 * draw.standard_normal() for axis in "XY" for kind in "FXYZ"}

    def outputs(self, felt: Felt) -> Array:
        t, a = self.truth, felt.force / STANDARD_GRAVITY
        y = felt.rate[:, 1] + t["D_X_F"] + a @ [t["D_X_X"], t["D_X_Y"], t["D_X_Z"]]
        x = felt.rate[:, 0] + t["D_Y_F"] + a @ [t["D_Y_X"], t["D_Y_Y"], t["D_Y_Z"]]
        e, xi = np.radians(t["epsilon"] / 60), np.radians(t["xi"] / 60)
        first = (np.cos(e + xi) * y + np.sin(e + xi) * x) / (t["SF_Y"] * np.cos(xi))
        second = (-np.sin(e) * y + np.cos(e) * x) / (t["SF_X"] * np.cos(xi))
        return np.stack([first, second], axis=1)


EIGHT_POSITIONS = Campaign(
    _plan(
        _EIGHT_STEPS,
        "title: eight positions\nsensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}\ndefaults: {settle: 30 s}",
        "  drift: {estimator: flexure_gyro_static, segments: P*}",
    ),
    f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, gyro]
instruments:
{TABLE}\
  gyro:
    driver: virtual_flexure_gyro
    scale_factor: {{{{x: 0.2 (deg/h)/(pulse/s), y: 0.2 (deg/h)/(pulse/s)}}}}
    drift_x: {{{{F: 0 deg/h, X: 0 deg/h/g, Y: 0 deg/h/g, Z: 0 deg/h/g}}}}
    drift_y: {{{{F: 0 deg/h, X: 0 deg/h/g, Y: 0 deg/h/g, Z: 0 deg/h/g}}}}
    white_noise: 0.9 pulse/sqrt(s)
    bias_instability: {{flicker[0]}} pulse/s
    resolution: {{count[0]}} pulse/s
    full_scale: 1000000 pulse/s
    sample_rate: 50 Hz
""",
    _EIGHT_STEPS,
    50.0,
    {"torquer_x": "pulse/s", "torquer_y": "pulse/s"},
    0.9 * np.sqrt(50.0) * np.ones(2),
    "drift",
    FlexureGyro,
    without=_ANEW,
)


# A line through rates -------------------------------------------------------------------------------------------------

_RATES = (300.0, -300.0, 200.0, -200.0, 100.0, -100.0, 50.0, -50.0, 20.0, -20.0)
_RATE_STEPS = tuple(Step(f"R{rate:+g}", "east north up", 36.0, rate, 10.0) for rate in _RATES)  # whole turns


class RateGyro:
    """deg/s: F0 + K·rate of the table, where F0 has the vertical component of the Earth's rate in it."""

    def __init__(self, draw: np.random.Generator) -> None:
        self.scale, self.bias = 1 + 0.01 * draw.standard_normal(), 0.1 * draw.standard_normal()
        self.truth: Mapping[str, float] = {"K_gyro_z": self.scale, "F0_gyro_z": self.bias + self.scale * UPWARD / 3600}

    def outputs(self, felt: Felt) -> Array:
        return self.bias + self.scale * felt.rate[:, 2:] / 3600


_GYRO_WHITE = 0.005  # deg/s/√Hz
RATES = Campaign(
    _plan(
        _RATE_STEPS,
        "title: rates\nsensor: {kind: gyro, outputs: [gyro_z]}\ndefaults: {settle: 5 s}",
        '  line: {estimator: scale_factor, segments: "*", outputs: gyro_z}',
    ),
    f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, gyro]
instruments:
{TABLE}\
  gyro:
    driver: virtual_imu
    kind: gyro
    sample_rate: 50 Hz
    gyros:
      full_scale: 1000 deg/s
      angle_random_walk: {_GYRO_WHITE} deg/s*sqrt(s)
      bias_instability: {{flicker[0]}} deg/s
      resolution: {{count[0]}} deg/s
      axes:
        z: {{{{}}}}
""",
    _RATE_STEPS,
    50.0,
    {"gyro_z": "deg/s"},
    _GYRO_WHITE * np.sqrt(50.0) * np.ones(1),
    "line",
    RateGyro,
    without=_ANEW,  # its positions do not matter
)


# Twelve positions and six rates of an inertial measurement unit -------------------------------------------------------

TWELVE = (
    *("east north up", "west south up", "east south down", "west north down"),
    *("up east north", "up west south", "down east south", "down west north"),
    *("north up east", "south up west", "south down east", "north down west"),
)
_TWELVE_STEPS = tuple(Step(f"P{number:02}", axes, 60.0) for number, axes in enumerate(TWELVE, start=1))
_TURN_STEPS = tuple(
    Step(f"{axis}{sign:+d}", axes, 60.0, sign * 60.0)
    for axis, axes in (("X", "up east north"), ("Y", "north up east"), ("Z", "east north up"))
    for sign in (1, -1)
)
_UNIT_WHITE = np.repeat([0.005, 1e-3], 3)  # deg/s/√Hz, m/s²/√Hz


class Unit:
    """Gyros, deg/s: M·ω + b + G·f; accelerometers, m/s²: M·f + b, with matrices within some per cent of identity."""

    def __init__(self, draw: np.random.Generator) -> None:
        near = 0.3 + 0.7 * np.eye(3)
        self.gyro = np.eye(3) + 0.01 * draw.standard_normal((3, 3)) * near
        self.accel = np.eye(3) + 0.01 * draw.standard_normal((3, 3)) * near
        self.gyro_bias = 100 * draw.standard_normal(3)  # deg/h
        self.accel_bias = 5e-3 * STANDARD_GRAVITY * draw.standard_normal(3)
        self.sensitivity = 20 * draw.standard_normal((3, 3))  # deg/h/g
        self.truth: dict[str, float] = {}
        for i, axis in enumerate("xyz"):
            self.truth[f"gyro_bias_{axis}"] = self.gyro_bias[i]
            self.truth[f"accel_bias_{axis}"] = self.accel_bias[i] / STANDARD_GRAVITY * 1e3
            for kind, matrix in (("gyro", self.gyro), ("accel", self.accel)):
                length = float(np.sqrt(np.sum(matrix[i] ** 2)))
                self.truth[f"{kind}_scale_{axis}"] = length
                for j, other in enumerate("xyz"):
                    if i != j:
                        self.truth[f"{kind}_misalignment_{axis}_{other}"] = matrix[i, j] / length * 1e3
            for j, other in enumerate("xyz"):
                self.truth[f"gyro_g_sensitivity_K_{other}_{axis}"] = self.sensitivity[i, j]

    def outputs(self, felt: Felt) -> Array:
        gyro = felt.rate @ self.gyro.T + self.gyro_bias + felt.force / STANDARD_GRAVITY @ self.sensitivity.T
        return np.hstack([gyro / 3600, felt.force @ self.accel.T + self.accel_bias])


UNIT = Campaign(
    _plan(
        (*_TWELVE_STEPS, *_TURN_STEPS),
        "title: unit\nsensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}\ndefaults: {settle: 5 s}",
        "  imu: {estimator: imu_multi_position, gyros: [gyro_x, gyro_y, gyro_z], accelerometers: [accel_x, accel_y, accel_z]}",
    ),
    f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, unit]
instruments:
{TABLE}\
  unit:
    driver: virtual_imu
    kind: imu
    sample_rate: 50 Hz
    gyros:
      full_scale: 1000 deg/s
      angle_random_walk: {_UNIT_WHITE[0]} deg/s*sqrt(s)
      bias_instability: {{flicker[0]}} deg/s
      resolution: {{count[0]}} deg/s
      axes: {{{{x: {{{{}}}}, y: {{{{}}}}, z: {{{{}}}}}}}}
    accelerometers:
      full_scale: 10 g
      velocity_random_walk: {_UNIT_WHITE[3]} m/s^2*sqrt(s)
      bias_instability: {{flicker[3]}} m/s^2
      resolution: {{count[3]}} m/s^2
      axes: {{{{x: {{{{}}}}, y: {{{{}}}}, z: {{{{}}}}}}}}
""",
    (*_TWELVE_STEPS, *_TURN_STEPS),
    50.0,
    {f"{kind}_{axis}": unit for kind, unit in (("gyro", "deg/s"), ("accel", "m/s^2")) for axis in "xyz"},
    _UNIT_WHITE * np.sqrt(50.0),
    "imu",
    Unit,
)


# The same with effects beyond matrices and biases ---------------------------------------------------------------------


class RichUnit:
    """A unit whose gyros, deg/h, also answer by a·|ω|, and whose accelerometers, m/s², by k·f²."""

    def __init__(self, draw: np.random.Generator) -> None:
        self.plain = Unit(draw)
        self.asymmetry = 1e-4 * draw.standard_normal(3)
        self.square = 5e-4 / STANDARD_GRAVITY * draw.standard_normal(3)  # per m/s²
        known, self.truth = self.plain.truth, dict[str, float]()
        for i, axis in enumerate("xyz"):
            self.truth[f"gyro_bias_{axis}"] = known[f"gyro_bias_{axis}"] / 3600  # deg/s
            self.truth[f"accel_bias_{axis}"] = known[f"accel_bias_{axis}"]
            self.truth[f"gyro_scale_asymmetry_{axis}"] = 1e6 * self.asymmetry[i]
            self.truth[f"accel_second_order_{axis}"] = 1e6 * self.square[i] * STANDARD_GRAVITY
            for kind, matrix in (("gyro", self.plain.gyro), ("accel", self.plain.accel)):
                self.truth[f"{kind}_scale_factor_{axis}"] = 1e6 * (matrix[i, i] - 1)
                for j, other in enumerate("xyz"):
                    if i != j:
                        self.truth[f"{kind}_misalignment_towards_{other}_{axis}"] = np.degrees(matrix[i, j]) * 3600
            for j, other in enumerate("xyz"):
                self.truth[f"gyro_g_sensitivity_K_{other}_{axis}"] = self.plain.sensitivity[i, j] / 3600

    def outputs(self, felt: Felt) -> Array:
        made = self.plain.outputs(felt)
        return made + np.hstack([self.asymmetry * np.abs(felt.rate) / 3600, self.square * felt.force**2])


_GYRO_EFFECTS = "[gyro_bias, gyro_scale_factor, gyro_misalignment, gyro_g_sensitivity, gyro_scale_asymmetry]"
_ACCEL_EFFECTS = "[accel_bias, accel_scale_factor, accel_misalignment, accel_second_order]"
RICH_UNIT = Campaign(
    _plan(
        (*_TWELVE_STEPS, *_TURN_STEPS),
        "title: unit\nsensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}\ndefaults: {settle: 5 s}",
        "  model:\n    estimator: error_model\n    outputs:\n"
        + "".join(f"      gyro_{axis}: {_GYRO_EFFECTS}\n      accel_{axis}: {_ACCEL_EFFECTS}\n" for axis in "xyz"),
    ),
    UNIT.bench,
    UNIT.steps,
    UNIT.sampling,
    UNIT.channels,
    UNIT.white,
    "model",
    RichUnit,
)


# The same at other supply voltages and pressures ----------------------------------------------------------------------

_STATES = ((12.0, 1010.0), (13.5, 1010.0), (12.0, 620.0))  # V, hPa
_HALVES = ((*_TWELVE_STEPS[::2], *_TURN_STEPS[:3]), (*_TWELVE_STEPS[1::2], *_TURN_STEPS[3:]))
_SUPPLIED_STEPS = tuple(  # there and back again, so that a drift looks like none of the states
    replace(step, label=f"{step.label}-{volts:g}V-{pressure:g}hPa", dwell=30.0, volts=volts, hectopascals=pressure)
    for steps, states in zip(_HALVES, (_STATES, _STATES[::-1]), strict=True)
    for volts, pressure in states
    for step in steps
)
_NOMINAL_SUPPLY, _ATMOSPHERE = 12.0, 1013.25  # V, hPa


class SuppliedUnit:
    """A unit whose biases and scale factors change in proportion to its supply and to the pressure of the air. Both differ by some per cent
    from what the plan states, and drift within each step; two meters show what they are."""

    def __init__(self, draw: np.random.Generator) -> None:
        self.plain = Unit(draw)
        self.stray = draw.standard_normal((len(_SUPPLIED_STEPS), 2)) * [0.1, 8.0]  # V, hPa
        self.drift = draw.standard_normal((len(_SUPPLIED_STEPS), 2)) * [1e-3, 0.1]  # V/s, hPa/s
        self.gyro_bias = draw.standard_normal((2, 3)) * [[40.0], [0.2]]  # deg/h per V and per hPa
        self.accel_bias = draw.standard_normal((2, 3)) * [[3e-3], [2e-5]]  # m/s² per V and per hPa
        self.gyro_scale = draw.standard_normal((2, 3)) * [[3e-4], [3e-6]]  # per V and per hPa
        self.accel_scale = draw.standard_normal((2, 3)) * [[3e-4], [3e-6]]
        known, self.truth = self.plain.truth, dict[str, float]()
        for i, axis in enumerate("xyz"):
            self.truth[f"gyro_bias_{axis}"] = known[f"gyro_bias_{axis}"] / 3600
            self.truth[f"accel_bias_{axis}"] = known[f"accel_bias_{axis}"]
            for k, cause in enumerate(("supply", "pressure")):
                self.truth[f"gyro_bias_{cause}_{axis}"] = self.gyro_bias[k, i] / 3600  # deg/s
                self.truth[f"accel_bias_{cause}_{axis}"] = self.accel_bias[k, i] / STANDARD_GRAVITY * 1e6
                self.truth[f"gyro_scale_{cause}_{axis}"] = 1e6 * self.gyro_scale[k, i]
                self.truth[f"accel_scale_{cause}_{axis}"] = 1e6 * self.accel_scale[k, i]
            for kind, matrix in (("gyro", self.plain.gyro), ("accel", self.plain.accel)):
                self.truth[f"{kind}_scale_factor_{axis}"] = 1e6 * (matrix[i, i] - 1)
                for j, other in enumerate("xyz"):
                    if i != j:
                        self.truth[f"{kind}_misalignment_towards_{other}_{axis}"] = np.degrees(matrix[i, j]) * 3600
            for j, other in enumerate("xyz"):
                self.truth[f"gyro_g_sensitivity_K_{other}_{axis}"] = self.plain.sensitivity[i, j] / 3600

    def outputs(self, felt: Felt) -> Array:
        stated = np.array([(step.volts, step.hectopascals) for step in _SUPPLIED_STEPS])
        begun = np.array([felt.time[felt.step == k][0] for k in range(len(stated))])
        since = (felt.time - begun[felt.step])[:, None]
        actual = (stated + self.stray)[felt.step] + self.drift[felt.step] * since
        off = actual - [_NOMINAL_SUPPLY, _ATMOSPHERE]
        gyro = (off @ self.gyro_bias + off @ self.gyro_scale * felt.rate) / 3600
        accel = off @ self.accel_bias + off @ self.accel_scale * felt.force
        return np.hstack([self.plain.outputs(felt) + np.hstack([gyro, accel]), actual])


_SUPPLIED_GYRO = (
    "[gyro_bias, gyro_scale_factor, gyro_misalignment, gyro_g_sensitivity, gyro_bias_supply, gyro_scale_supply, "
    "gyro_bias_pressure, gyro_scale_pressure]"
)
_SUPPLIED_ACCEL = _SUPPLIED_GYRO.replace("gyro_g_sensitivity, ", "").replace("gyro", "accel")
SUPPLIED_UNIT = Campaign(
    _plan(
        _SUPPLIED_STEPS,
        "title: unit\nsensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z, supply_voltage, "
        "ambient_pressure]}\ndefaults: {settle: 5 s}",
        "  model:\n    estimator: error_model\n    supply_channel: supply_voltage\n    pressure_channel: ambient_pressure\n    outputs:\n"
        + "".join(f"      gyro_{axis}: {_SUPPLIED_GYRO}\n      accel_{axis}: {_SUPPLIED_ACCEL}\n" for axis in "xyz"),
    ),
    UNIT.bench + f"    nominal_supply: {_NOMINAL_SUPPLY} V\n    voltmeter_noise: 2 mV\n    barometer_noise: 0.05 hPa\n",
    _SUPPLIED_STEPS,
    UNIT.sampling,
    {**UNIT.channels, "supply_voltage": "V", "ambient_pressure": "hPa"},
    np.append(UNIT.white, [2e-3, 0.05]),
    "model",
    SuppliedUnit,
)


# Accelerometers alone -------------------------------------------------------------------------------------------------


class Triad:
    """m/s²: M·f + b."""

    def __init__(self, draw: np.random.Generator) -> None:
        unit = Unit(draw)
        self.matrix, self.bias = unit.accel, unit.accel_bias
        self.truth: dict[str, float] = {}
        for i, axis in enumerate("xyz"):
            self.truth[f"bias_{axis}"] = unit.truth[f"accel_bias_{axis}"]
            self.truth[f"scale_{axis}"] = unit.truth[f"accel_scale_{axis}"]
            for other in "xyz"[:i] + "xyz"[i + 1 :]:
                self.truth[f"misalignment_{axis}_{other}"] = unit.truth[f"accel_misalignment_{axis}_{other}"]

    def outputs(self, felt: Felt) -> Array:
        return np.asarray(felt.force @ self.matrix.T + self.bias)


TRIAD = Campaign(
    _plan(
        _TWELVE_STEPS,
        "title: triad\nsensor: {kind: accelerometers, outputs: [accel_x, accel_y, accel_z]}\ndefaults: {settle: 5 s}",
        "  triad: {estimator: accelerometer_multi_position}",
    ),
    f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, unit]
instruments:
{TABLE}\
  unit:
    driver: virtual_imu
    kind: accelerometers
    sample_rate: 50 Hz
    accelerometers:
      full_scale: 10 g
      velocity_random_walk: {_UNIT_WHITE[3]} m/s^2*sqrt(s)
      bias_instability: {{flicker[0]}} m/s^2
      resolution: {{count[0]}} m/s^2
      axes: {{{{x: {{{{}}}}, y: {{{{}}}}, z: {{{{}}}}}}}}
""",
    _TWELVE_STEPS,
    50.0,
    {f"accel_{axis}": "m/s^2" for axis in "xyz"},
    _UNIT_WHITE[3:] * np.sqrt(50.0),
    "triad",
    Triad,
    without=_ANEW,
)


# Three axes in one tilted mounting ------------------------------------------------------------------------------------

_LEAN, _AROUND = 54.7356, (0.0, 120.0, 240.0)  # deg: of the input axes from the vertical, and about it from east
_FIXTURE = 20.0  # arcsec, standard uncertainty of each angle
_PULSES = 40_000.0  # pulse/s per deg/s
_TILTED_RATES = ((300.0, 30.0), (60.0, 30.0), (10.0, 36.0), (1.0, 360.0))  # deg/s, s: whole turns
_TILTED_STEPS = (
    Step("start-zero", "east north up", 60.0),
    *(
        Step(f"R{sign * rate:+g}", "east north up", dwell, sign * rate)
        for rate, dwell in _TILTED_RATES
        for sign in (1, -1)
    ),
    Step("end-zero", "east north up", 60.0),
)
_TILTED_WHITE = 200.0  # pulse/s/√Hz: 0.005 deg/s/√Hz


class TiltedTriad:
    """pulse/s: K·(rate along the input axis + bias), each axis wrong by its fixture's error, arcsec."""

    def __init__(self, draw: np.random.Generator, fixture: float = _FIXTURE) -> None:
        lean = np.radians(_LEAN + fixture / 3600 * draw.standard_normal(3))
        around = np.radians(_AROUND)
        self.axes = np.stack([np.sin(lean) * np.cos(around), np.sin(lean) * np.sin(around), np.cos(lean)], axis=1)
        self.scale = _PULSES * (1 + 0.01 * draw.standard_normal(3))
        self.bias = 0.01 * draw.standard_normal(3)  # deg/s
        self.truth: Mapping[str, float] = {f"K_{axis}": value for axis, value in zip("xyz", self.scale, strict=True)}

    def outputs(self, felt: Felt) -> Array:
        return np.asarray(self.scale * (felt.rate / 3600 @ self.axes.T + self.bias))


_MOUNTED = "\n".join(
    f"  {axis}: {{angle: {_LEAN} deg ± {_FIXTURE} arcsec, azimuth: {azimuth} deg}}"
    for axis, azimuth in zip("xyz", _AROUND, strict=True)
)
TILTED = Campaign(
    _plan(
        _TILTED_STEPS,
        "title: tilted\nsensor: {kind: gyro-triad, outputs: [gyro_x, gyro_y, gyro_z]}\ndefaults: {settle: 5 s}\n"
        f"mounting:\n{_MOUNTED}",
        "  scale: {estimator: scale_factor_tilted, zero: [start-zero, end-zero], earth_rate: corrected, uncertainty: residual}",
    ),
    f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, triad]
instruments:
  table:
    driver: virtual_table
    axes:
      - {{{{name: rotation, direction: up, max_rate: 400 deg/s, max_acceleration: 100 deg/s^2}}}}
    position_uncertainty: {{tilt}} arcsec
    rate_stability: {{rate}} ppm
  triad:
    driver: virtual_imu
    kind: gyro-triad
    sample_rate: 50 Hz
    gyros:
      scale_factor: {_PULSES} (pulse/s)/(deg/s)
      full_scale: 1000 deg/s
      angle_random_walk: {_TILTED_WHITE / _PULSES} deg/s*sqrt(s)
      bias_instability: {{flicker[0]}} deg/s
      resolution: {{count[0]}} deg/s
      axes: {{{{x: {{{{}}}}, y: {{{{}}}}, z: {{{{}}}}}}}}
""",
    _TILTED_STEPS,
    50.0,
    {f"gyro_{axis}": "pulse/s" for axis in "xyz"},
    _TILTED_WHITE * np.sqrt(50.0) * np.ones(3),
    "scale",
    TiltedTriad,
    _PULSES,
)


def _quiet(campaign: Campaign, share: float) -> Campaign:
    """The same campaign with less noise in a better fixture, and intervals from the scatter within the segments."""
    fixture = f"± {_FIXTURE} arcsec"
    assert fixture in campaign.plan
    noise = f"angle_random_walk: {_TILTED_WHITE / _PULSES} deg"
    assert noise in campaign.bench
    return replace(
        campaign,
        plan=campaign.plan.replace("uncertainty: residual", "uncertainty: within_segment").replace(
            fixture, f"± {share * share * _FIXTURE} arcsec"
        ),
        device=partial(TiltedTriad, fixture=share * share * _FIXTURE),
        bench=campaign.bench.replace(noise, f"angle_random_walk: {share * _TILTED_WHITE / _PULSES} deg"),
        white=share * campaign.white,
    )


TILTED_WITHIN = _quiet(TILTED, 0.05)
"""Noise so low that what the axes see of the Earth's rate while they turn is four times that of a batch's mean, and up to sixteen times."""


# Noise at rest --------------------------------------------------------------------------------------------------------

_REST_STEPS = (Step("rest", "east north up", 2000.0),)


class RestingGyro:
    """deg/s: its bias and the vertical component of the Earth's rate. What is sought is the noise that every world has."""

    def __init__(self, draw: np.random.Generator) -> None:
        self.bias = 0.1 * draw.standard_normal()
        self.truth: Mapping[str, float] = {"N_gyro_z": _GYRO_WHITE * 60}  # deg/√h

    def outputs(self, felt: Felt) -> Array:
        return self.bias + felt.rate[:, 2:] / 3600


RESTING = Campaign(
    _plan(
        _REST_STEPS,
        "title: rest\nsensor: {kind: gyro, outputs: [gyro_z]}\ndefaults: {settle: 5 s}",
        "  noise: {estimator: allan_deviation, segments: rest, outputs: [gyro_z]}",
    ),
    RATES.bench,
    _REST_STEPS,
    50.0,
    RATES.channels,
    RATES.white,
    "noise",
    RestingGyro,
    without=(*_OF_THE_TABLE, "reversed channel"),  # none of them changes the noise
    causes={"20 Hz line": "periodic disturbance", "rounding carried over": "rounded"},
)


# Navigation at rest, and from stop to stop ----------------------------------------------------------------------------

_ALIGN = Step("align", "east north up", 600.0)
_AT_REST = Step("navigate", "east north up", 7200.0, pause=0.0)
_SIXTEEN = (180, 90, -180, -90, -180, -90, 180, 90, -180, 90, 180, -90, 180, -90, -180, 90)
_CARRIED_ROUND = Step("navigate", "east north up", 7200.0, 10.0, 0.0, _SIXTEEN, 60.0)
_GYRO_ERROR, _ACCEL_ERROR = 0.02, 50.0  # deg/h, µg, of each sensor
_NAVIGATION_WHITE = np.repeat([0.002 / 60, 0.03 / 60], 3)  # deg/s·√s, m/s²·√s
_COURSE = 10.0  # s


class NavigatingUnit:
    """Gyros, deg/s, and accelerometers, m/s², each with a constant error. Alignment leaves it as if it took a very long time; what is
    sought is the true attitude, and the errors that the constants cause."""

    def __init__(self, draw: np.random.Generator, step: Step) -> None:
        self.gyro = _GYRO_ERROR / 3600 * draw.standard_normal(3)  # deg/s
        self.accel = _ACCEL_ERROR * 1e-6 * STANDARD_GRAVITY * draw.standard_normal(3)
        course = navigated(np.radians(self.gyro), self.accel, step.angle, step.dwell, _COURSE)
        self.truth: Mapping[str, float] = {"heading": 0.0, "pitch": 0.0, "roll": 0.0} | figures(course)

    def outputs(self, felt: Felt) -> Array:
        return np.hstack([felt.rate / 3600 + self.gyro, felt.force + self.accel])


def _navigation(step: Step) -> Campaign:
    return Campaign(
        _plan(
            (_ALIGN, step),
            "title: navigation\n"
            "sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}\n"
            "defaults: {on_break: keep}",
            "  free: {estimator: strapdown_navigation, segments: [align, navigate], "
            f"gyro_uncertainty: {_GYRO_ERROR} deg/h, accelerometer_uncertainty: {_ACCEL_ERROR} ug}}",
        ),
        f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, unit]
instruments:
  table:
    driver: virtual_table
    axes:
      - {{{{name: azimuth, direction: up, max_rate: 100 deg/s, max_acceleration: 1000 deg/s^2}}}}
    position_uncertainty: {{tilt}} arcsec
    rate_stability: {{rate}} ppm
  unit:
    driver: virtual_imu
    kind: imu
    sample_rate: 10 Hz
    gyros:
      full_scale: 300 deg/s
      angle_random_walk: {_NAVIGATION_WHITE[0]} deg/s*sqrt(s)
      bias_instability: {{flicker[0]}} deg/s
      resolution: {{count[0]}} deg/s
      axes: {{{{x: {{{{}}}}, y: {{{{}}}}, z: {{{{}}}}}}}}
    accelerometers:
      full_scale: 20 g
      velocity_random_walk: {_NAVIGATION_WHITE[3]} m/s^2*sqrt(s)
      bias_instability: {{flicker[3]}} m/s^2
      resolution: {{count[3]}} m/s^2
      axes: {{{{x: {{{{}}}}, y: {{{{}}}}, z: {{{{}}}}}}}}
""",
        (_ALIGN, step),
        10.0,
        UNIT.channels,
        _NAVIGATION_WHITE * np.sqrt(10.0),
        "free",
        partial(NavigatingUnit, step=step),
        # Both steps have one position. No rate is held. At 10 Hz, vibration at 20 Hz is a constant.
        without=(*_OF_THE_TABLE, "20 Hz line"),
        # Its axes stay level, and at rest its x points east.
        unsigned=("accel_x", "accel_y") if step.moves else ("gyro_x", "accel_x", "accel_y"),
    )


# Rocking of a platform -----------------------------------------------------------------------------------------------

_INSTALLED = {"xz": 12.0, "xy": -8.0, "yz": 5.0, "yx": 9.0, "zy": -3.0, "zx": 14.0}  # arcsec
_ACCEL_WHITE = 5e-6  # g/√Hz
_ROCKING_STEPS = tuple(
    step
    for axes, state in zip(RINGS, ("vertical", "horizontal"), strict=True)
    for repeat in (1, 2, 3)
    for name in ("static-1", "dynamic-1", "dynamic-2", "static-2")
    for step in (
        Step(f"{state}{repeat}-cage-{name}", axes, 10.0, mode="caged"),
        Step(f"{state}{repeat}-{name}", axes, 600.0, mode="navigation", rocks=name.startswith("dynamic")),
    )
)


def _rocking(azimuth: str) -> Campaign:
    angles = ", ".join(f"{name}: {value} arcsec ± 2 arcsec" for name, value in _INSTALLED.items())
    sizes = Sizes()
    stability = sizes.bias_walk * np.sqrt((SECOND - FIRST) / 3600)
    return Campaign(
        _plan(
            _ROCKING_STEPS,
            "title: rocking\nsensor: {kind: stabilised-platform, outputs: [accel_x, accel_y, accel_z]}\n"
            f"defaults: {{settle: {SETTLE} s}}",
            f'  rocking: {{estimator: rocking_drift, segments: "*", azimuth: {azimuth}, '
            f"azimuth_uncertainty: {sizes.caging} arcmin, drift_repeatability: {sizes.drift} deg/h, random_walk: {sizes.walk} deg/sqrt(h), "
            f"accelerometer_stability: {stability:.3g} ug, installation_angles: {{{angles}}}}}",
        ),
        f"""planrunner_bench: 1
name: world
clock: virtual
{SITE}
safe_order: [table, platform]
instruments:
  table:
    driver: virtual_table
    axes:
      - {{{{name: outer, direction: north, max_rate: 60 deg/s, max_acceleration: 100 deg/s^2}}}}
      - {{{{name: middle, direction: east, max_rate: 60 deg/s, max_acceleration: 100 deg/s^2}}}}
      - {{{{name: inner, direction: up, max_rate: 60 deg/s, max_acceleration: 100 deg/s^2}}}}
    position_uncertainty: 15 arcsec
  platform:
    driver: virtual_platform
    sample_rate: 3 Hz
    accelerometers: {{{{white_noise: 5 ug*sqrt(s)}}}}
""",
        _ROCKING_STEPS,
        3.0,
        {f"accel_{axis}": "g" for axis in "xyz"}
        | {f"{body}_{ring}": "deg" for body in ("gimbal", "table") for ring in ("outer", "middle", "inner")},
        np.concatenate([_ACCEL_WHITE * np.sqrt(3.0) * np.ones(3), np.full(3, 1 / 3600), np.full(3, 0.4 / 3600)]),
        "rocking",
        partial(Platform, steps=_ROCKING_STEPS, installation=tuple(_INSTALLED.values())),
        without=(
            "flicker, declared",
            *_OF_THE_TABLE,
            "counts of 5 times the noise",
        ),
    )


# Temperature cycles ---------------------------------------------------------------------------------------------------


def _temperature_cycles(cycles: int) -> Campaign:
    """At rest at one position, sampled once a second: 20 Hz are a constant. With the wrong sign it is a sound gyro of another bias and
    slope. While the temperature changes, its rounding errors average out."""
    return replace(
        temperature_cycles.campaign(cycles, ", order: 2"),
        celsius=temperature_cycles.course(cycles),
        without=(*_OF_THE_TABLE, "temperature drift, recorded", "20 Hz line", "reversed channel"),
        causes={"counts of 5 times the noise": ""},
    )


CAMPAIGNS: Mapping[str, Campaign] = {
    "flexure_gyro_static": EIGHT_POSITIONS,
    "scale_factor": RATES,
    "imu_multi_position": UNIT,
    "error_model": RICH_UNIT,
    "error_model, supply and pressure": SUPPLIED_UNIT,
    "accelerometer_multi_position": TRIAD,
    "scale_factor_tilted": TILTED,
    "scale_factor_tilted, within segments": TILTED_WITHIN,
    "temperature_model, one cycle": _temperature_cycles(1),
    "temperature_model, two cycles": _temperature_cycles(2),
    "allan_deviation": RESTING,
    "strapdown_navigation at rest": _navigation(_AT_REST),
    "strapdown_navigation from stop to stop": _navigation(_CARRIED_ROUND),
    "rocking_drift": _rocking("encoders"),
    "rocking_drift, nominal azimuth": _rocking("nominal"),
}
