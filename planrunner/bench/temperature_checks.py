"""Checks temperatures. Reports temperatures outside the range of the chamber, ramps that end before the target, and soaks that are
too short for a sensor whose temperature follows the air temperature slowly."""

from __future__ import annotations

from planrunner.base.findings import Findings, Mark
from planrunner.bench.model import BenchModels
from planrunner.plan.units import ZERO_CELSIUS

_FORGOTTEN = 40.0  # time constants after which the rest of a change is negligible


class Temperatures:
    """Follows the setpoint of the chamber, and the temperature of the sensor, which lags behind the temperature of the air."""

    def __init__(self, models: BenchModels, log: Findings):
        self._chamber, self._replays, self._log = models.chamber, models.replays, log
        self._lag = models.sensor.thermal_lag if models.sensor else 0.0
        self._set = models.chamber.ambient if models.chamber else 0.0  # K, the last setpoint
        self._changes: list[tuple[float, float]] = []  # when [s] and by how much [K] it changed
        self._reached = 0.0  # s, when the air came within tolerance of it
        self._warned: float | None = None  # time of the change whose soak was reported as too short

    def change(self, kelvin: float | None, now: float, mark: Mark) -> float:
        """Changes the setpoint of the chamber to `kelvin` at the time `now` [s]; returns the time [s] until the air has reached the
        setpoint."""
        if kelvin is None or not self._within_reach(kelvin, mark):
            return 0.0
        return self._head_for(kelvin, now)

    def ramp(self, kelvin: float, now: float, dwell: float | None, mark: Mark) -> None:
        """Starts, at the time `now` [s], a temperature ramp to `kelvin` during which samples are recorded. `dwell`: time for which
        samples are recorded, s; None if it is not known."""
        if not self._within_reach(kelvin, mark):
            return
        assert self._chamber is not None
        change = kelvin - self._set
        seconds, ramping = self._head_for(kelvin, now), abs(change) / self._chamber.ramp
        if dwell is None or dwell >= seconds * (1 - 1e-9):
            return
        here, there = kelvin - change - ZERO_CELSIUS, kelvin - ZERO_CELSIUS
        pace = f"{self._chamber.ramp * 60:g} K/min"
        if dwell < ramping:
            got = here + (1 if change > 0 else -1) * self._chamber.ramp * dwell
            message = (
                f"the ramp from {here:g} to {there:g} degC takes {_minutes(ramping)} at the chamber's {pace}; the dwell of "
                f"{_minutes(dwell)} ends at {got:.3g} degC"
            )
            hint = f"dwell for {_minutes(seconds)}, or ramp to {got:.3g} degC"
            self._log.error("physics-ramp", mark, message, hint)
        else:
            message = (
                f"the setpoint is at {there:g} degC when the dwell of {_minutes(dwell)} ends, but the air follows it "
                f"{_minutes(self._chamber.lag)} later: the air takes {_minutes(seconds)} to come within {self._chamber.tolerance:g} K"
            )
            self._log.warning("physics-ramp", mark, message, f"dwell for {_minutes(seconds)}")

    def check_soaked(self, label: str, now: float, soak: float, mark: Mark) -> None:
        """Warns if, at the beginning of the dwell, the temperature of the sensor differs from the setpoint by more than the
        chamber's tolerance. The temperature of the sensor is computed with the declared lag of the sensor. The warning is given
        once for each change of the setpoint, because a soak that is long enough for the first segment is also long enough for the
        following segments."""
        if self._chamber is None or not self._lag or self._warned == self._reached:
            return
        left = self._behind(now)
        tolerance = self._chamber.tolerance
        if abs(left) <= tolerance:
            return
        self._warned = self._reached
        low, high = now, now + self._lag
        while abs(self._behind(high)) > tolerance:
            low, high = high, high + self._lag
        while high - low > 1.0:
            middle = (low + high) / 2
            low, high = (middle, high) if abs(self._behind(middle)) > tolerance else (low, middle)
        waited = now - self._reached
        message = (
            f"the sensor follows the air with a declared time constant of {_minutes(self._lag)}: the record of '{label}' begins "
            f"{_minutes(waited)} ({waited / self._lag:.2g} time constants) after the chamber reaches {self._set - ZERO_CELSIUS:g} degC, "
            f"when the sensor is still {abs(left):.2g} K from this temperature"
        )
        hint = f"soak for at least {_minutes(soak + high - now)}: the sensor is then within the chamber's tolerance of {tolerance:g} K"
        with self._log.resting_on(mark):  # a soak that could not be read counts as none
            self._log.warning("physics-soak", mark, message, hint)

    def return_time(self) -> float:
        """Returns the time [s] until the chamber is back at ambient temperature."""
        return 0.0 if self._chamber is None else self._chamber.seconds_to_change(self._set - self._chamber.ambient)

    def _head_for(self, kelvin: float, now: float) -> float:
        assert self._chamber is not None
        change = kelvin - self._set
        seconds = self._chamber.seconds_to_change(change)
        if change:
            self._changes = [(begun, by) for begun, by in self._changes if not self._forgotten(now - begun, by)]
            self._changes.append((now, change))
            self._set, self._reached = kelvin, now + seconds
        return seconds

    def _forgotten(self, seconds: float, kelvin: float) -> bool:
        assert self._chamber is not None
        return seconds > abs(kelvin) / self._chamber.ramp + _FORGOTTEN * (self._lag + self._chamber.lag)

    def _behind(self, now: float) -> float:
        """Returns the difference [K] between the setpoint and the temperature of the sensor. The sensor has not yet followed a part
        of each change of the setpoint; the difference is the sum of these parts."""
        assert self._chamber is not None
        return sum(self._chamber.behind(kelvin, self._lag, now - begun) for begun, kelvin in self._changes)

    def _within_reach(self, kelvin: float, mark: Mark) -> bool:
        chamber = self._chamber
        if chamber is None and self._replays:
            return False
        if chamber is None:
            hint = "use a bench with a chamber, or leave temperature out"
            self._log.error("physics-no-chamber", mark, "this bench has no chamber to hold a temperature", hint)
            return False
        if not chamber.lowest - 1e-9 <= kelvin <= chamber.highest + 1e-9:
            lowest, highest = chamber.lowest - ZERO_CELSIUS, chamber.highest - ZERO_CELSIUS
            message = f"{kelvin - ZERO_CELSIUS:g} degC is outside the chamber's range of {lowest:g} to {highest:g} degC"
            self._log.error("physics-temperature", mark, message, "stay within the chamber's range")
            return False
        return True


def _minutes(seconds: float) -> str:
    return (
        f"{seconds:.3g} s"
        if seconds < 100
        else f"{seconds / 60:.3g} min"
        if seconds < 6000
        else f"{seconds / 3600:.3g} h"
    )
