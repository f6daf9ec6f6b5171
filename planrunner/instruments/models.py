"""Defines models of instruments. These models are known without a connection to the instruments. Checks, schedules, designs and
estimators use them.

All values are in SI units, with angles in radians. The outputs of a sensor are an exception: their units are always named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.kinematics import TableAxis

DataOrigin = Literal["measured", "simulated", "replayed"]
"""Source of the samples of a run. `measured`: real instruments. `simulated`: instruments of which at least one is simulated.
`replayed`: an earlier recording."""

Senses = Literal["angular rate", "acceleration"]
"""Quantities that inertial outputs measure. The dimensions of these quantities have the same names."""

NOMINAL_SUPPLY = 5.0
"""Supply voltage [V] that is assumed if the bench file states none."""

_SHORT = 1e-3  # s; a lag that is too short to have an effect


@dataclass(frozen=True, slots=True)
class TableModel:
    """Describes a table that moves to positions and turns at rates.

    `axes`: the axes of the table, the outermost first. `position_uncertainty`: standard uncertainty of a position, rad.
    `rate_stability`: relative standard uncertainty of a rate. `orthogonality`: standard uncertainty of the angles between the axes,
    rad. `rocks`: True if the table can rock.
    """

    axes: tuple[TableAxis, ...]
    position_uncertainty: float = 0.0
    rate_stability: float = 0.0
    orthogonality: float = 0.0
    rocks: bool = True


@dataclass(frozen=True, slots=True)
class ChamberModel:
    """A temperature chamber.

    `lowest`, `highest`: limits of the temperature, K. `ramp`: rate of change of the setpoint, K/s. `ambient`: temperature in the
    safe state, K.

    `lag`: time constant [s] with which the air follows the setpoint. `tolerance`: a temperature counts as reached if the air
    differs from the setpoint by at most `tolerance` [K]. `temperature_uncertainty`: standard uncertainty [K] of the chamber's own
    thermometer.
    """

    lowest: float
    highest: float
    ramp: float
    ambient: float = 298.15
    lag: float = 0.0
    tolerance: float = 0.5
    temperature_uncertainty: float = 0.0

    def seconds_to_change(self, kelvin: float) -> float:
        """Returns the time [s] until the air is within the tolerance of a new setpoint. `kelvin`: the difference between the new
        and the present setpoint, K.

        At the end of a ramp with the rate r and the duration t, the output of a first-order lag with the time constant τ lags
        behind by r·τ·(1 − e^(−t/τ)). After the ramp, this difference decays with the time constant τ.
        """
        if abs(kelvin) <= self.tolerance:
            return 0.0
        ramping = abs(kelvin) / self.ramp
        if self.lag == 0.0:
            return ramping
        behind = self.ramp * self.lag * -math.expm1(-ramping / self.lag)
        return ramping + self.lag * max(0.0, math.log(behind / self.tolerance))

    def behind(self, kelvin: float, lag: float, seconds: float) -> float:
        """Returns the signed difference [K] between the setpoint and the temperature of a body, `seconds` after the start of a
        ramp.

        The body follows the air with the time constant `lag` [s]. The ramp changes the setpoint by `kelvin` and starts from
        equilibrium.

        At the time t of a ramp with the rate k, the output of two first-order lags in series, with the time constants a and s, lags
        behind the ramp by k·((a + s) − (a²·e^(−t/a) − s²·e^(−t/s))/(a − s)). A ramp that ends after T is the difference between an
        endless ramp and the same ramp started T later.
        """
        slope = math.copysign(self.ramp, kelvin)
        return slope * (self._lag_of_ramp(lag, seconds) - self._lag_of_ramp(lag, seconds - abs(kelvin) / self.ramp))

    def _lag_of_ramp(self, lag: float, seconds: float) -> float:
        """Returns the difference [K] that `behind` describes, for an endless ramp of 1 K/s, `seconds` after the start of the ramp.
        `lag`: time constant of the body, s."""
        if seconds <= 0:
            return 0.0
        a, s = max(self.lag, _SHORT), max(lag, _SHORT)
        s = s if abs(s - a) > 1e-6 * a else a * (1 + 1e-6)
        return (a + s) - (a * a * math.exp(-seconds / a) - s * s * math.exp(-seconds / s)) / (a - s)


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Describes the noise of one output, in the unit of the output.

    `white`: coefficient N of the white noise [unit·√s]; the mean over T seconds has the variance N²/T. `bias_instability`:
    coefficient B of IEEE Std 952 [unit]; the flat part of the Allan deviation is 0.664·B. `resolution`: size of one count [unit].
    `counted`: True if the remainder of a sample that does not fill a count is carried to the next sample, so that rounding acts
    only at the two ends of a mean. `states_flicker`: True if the bench file declares a bias instability, which may be zero.
    """

    white: float = 0.0
    bias_instability: float = 0.0
    resolution: float = 0.0
    counted: bool = False
    states_flicker: bool = False

    def dithers(self, variance: float | Array) -> NDArray[np.bool_]:
        """Returns True if the rounding of samples to counts averages out in a mean. The rounding averages out in two cases: if the
        noise of the samples is large enough to dither the rounding, or if remainders are carried from sample to sample (`counted`).
        `variance`: variance of the samples due to noise, unit²."""
        return np.logical_or(self.counted, np.asarray(variance) > (self.resolution / 2) ** 2)

    def rounding(self, samples: float | Array, variance: float | Array) -> Array:
        """Returns the variance [unit²] of the mean of some samples due to their rounding to counts. `variance`: variance of the
        samples due to noise, unit². If the rounding does not average out, the mean has the whole rounding error of one sample."""
        if self.counted:
            return np.asarray(self.resolution**2 / 6 / np.square(samples))
        return np.asarray(self.resolution**2 / 12 / np.where(self.dithers(variance), samples, 1.0))

    def standard_error(self, seconds: float | Array, rate_hz: float | Array) -> Array:
        """Returns the standard uncertainty of the mean of the samples that are taken at `rate_hz` during `seconds`, in the unit of
        the output and in the shape of the arguments."""
        rate = np.asarray(rate_hz)
        white = self.white**2 / np.maximum(seconds, 1.0 / rate)
        rounding = self.rounding(np.maximum(1.0, seconds * rate), self.white**2 * rate)
        return np.sqrt(white + rounding + self.bias_instability**2)

    def chance_of_no_change(self, seconds: float, rate_hz: float) -> float:
        """Returns an upper bound of the probability that all samples of a constant input are equal. The samples are taken at
        `rate_hz` during `seconds`.

        If remainders are not carried, the probability is largest for an input in the middle of a count. If remainders are carried,
        the sum of the noise is a random walk, which starts anywhere in a count and must stay within it. Consider two walls at the
        distance a from each other. A walk of n steps with the standard deviation σ stays between these walls with a probability of
        at most exp(−π²·n·σ²/(2·a²)). This bound follows from the series of H. S. Carslaw and J. C. Jaeger, Conduction of Heat in
        Solids, 3.3. As the walls act only once per step, a is larger than the count by 2·0.5826·σ (D. Siegmund, Sequential
        Analysis, 10.2).
        """
        if self.resolution == 0 or self.white == 0:
            return 0.0 if self.white else 1.0
        samples, sigma = max(1.0, seconds * rate_hz), self.white * math.sqrt(rate_hz)
        if self.counted:
            apart = self.resolution / sigma + 2 * 0.5826
            return math.exp(-samples * (math.pi / apart) ** 2 / 2)
        within = math.erf(self.resolution / (2 * math.sqrt(2) * sigma))
        return math.pow(within, samples)


@dataclass(frozen=True, slots=True)
class OutputModel:
    """Describes one output channel: its name, the unit in which it is recorded, its full scale and its noise.

    The full scale applies to both signs and is in the unit of the channel. `constant`: True if the output is exactly constant while
    the table is at rest, like the output of a simulated table encoder. `senses`: the quantity that the output senses, if the unit
    does not determine this quantity."""

    name: str
    unit: str
    full_scale: float = math.inf
    noise: NoiseModel = field(default_factory=NoiseModel)
    constant: bool = False
    senses: Senses | None = None


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The sensor under test. `nominal`: maps the name of each declared coefficient to its SI value. Predictions are linearised
    about these values.

    `modes`: operating modes that the driver can set, such as caged or navigation; empty if the sensor has only one mode.
    `one_rate`: True if the sensor samples only at `sample_rate` [Hz], False if it can also sample at lower rates. `thermal_lag`:
    time constant [s] with which the temperature of the sensor follows the temperature of the air; 0 if not declared.
    `records_angle`: True if the sensor records the table's angle about one axis, so that motion about several axes cannot be
    recorded. `nominal_supply`: supply voltage [V] at which the effects of the supply are zero. `stabilised`: True if gimbals
    decouple the outputs from the motion of the table.
    """

    kind: str
    outputs: tuple[OutputModel, ...]
    sample_rate: float
    nominal: Mapping[str, float] = field(default_factory=dict)
    modes: tuple[str, ...] = ()
    one_rate: bool = False
    thermal_lag: float = 0.0
    records_angle: bool = False
    nominal_supply: float = NOMINAL_SUPPLY
    stabilised: bool = False

    def rate_refused(self, asked: float | None) -> str:
        """Returns the reason why the sensor cannot be sampled at `asked` [Hz]; empty if this is possible, or if `asked` is None."""
        return rate_refused(asked, self.sample_rate, self.one_rate)

    def output(self, name: str) -> OutputModel | None:
        return next((item for item in self.outputs if item.name == name), None)


def rate_refused(asked: float | None, own: float, one_rate: bool) -> str:
    """Returns the reason why a sensor with the sample rate `own` [Hz] cannot be sampled at `asked` [Hz]; empty if this is possible,
    or if `asked` is None. `one_rate`: True if the sensor can only be sampled at `own`; False if it can also be sampled at lower
    rates."""
    if asked is None or abs(asked / own - 1) <= 1e-9:
        return ""
    if one_rate:
        return f"the sensor is set to {own:g} Hz, not {asked:g} Hz"
    return f"the sensor gives {own:g} Hz at most, not {asked:g} Hz" if asked > own else ""
