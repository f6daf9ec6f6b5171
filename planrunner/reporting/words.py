"""Provides the wording of states and times that reports, the show page and the terminal share."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from planrunner.plan.directions import word_of
from planrunner.plan.orientation import in_words
from planrunner.plan.schedule import Cycle, Motion, RecordedMotion, Rest, Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

AT_REST = "rest"


def number(value: float, digits: int = 6) -> str:
    """Returns a number without uncertainty as text, with at most `digits` significant digits."""
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "-∞"}.get(value, "not a number")
    text = re.sub(r"e([+-])0*(?=\d)", lambda match: "e-" if match[1] == "-" else "e", f"{value:.{digits}g}")
    return "0" if text == "-0" else text


def listed(names: Sequence[str], word: str = "and") -> str:
    """Returns the items as a list in words: `a`, `a and b`, or `a, b and c`. `word`: the word before the last item."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


def explanation(name: str) -> str:
    """Returns the name of an explanation of a gap as it is written within a sentence. The names are those of a diagnosis: an effect,
    several effects joined by "+", or "unknown"."""
    return "an unknown cause" if name == "unknown" else name


def behind_number(unit: str) -> str:
    """Returns the unit with a space before it, to follow a number; empty for pure numbers."""
    return "" if unit in ("", "1") else f" {unit}"


def rule(name: str, factor: float, coverage: float) -> str:
    """Returns a decision rule in words. If the guard band differs from U, or the coverage probability differs from 95 %, the text
    also states this."""
    if name != "guarded" or math.isnan(factor):
        return name
    band = [] if factor == 1 else [f"w = {number(factor)}·U"]
    wide = [] if coverage == 0.95 else [f"U at {number(100 * coverage)} %"]
    return f"{name} ({', '.join([*band, *wide])})" if band or wide else name


def probability(value: float) -> str:
    """Returns a probability in percent; near 0 % and 100 %, it is written as a bound."""
    if math.isnan(value):
        return "–"
    if value > 0.9995:
        return "> 99.9 %"
    return "< 0.1 %" if value < 0.0005 else f"{100 * value:.1f} %"


def duration(seconds: float | None) -> str:
    """Returns a duration in words, such as `1 min 35 s` for 95 s. Durations below ten seconds are shown with tenths of a second,
    and long durations in hours and days."""
    if seconds is None:
        return "as recorded"
    if not math.isfinite(seconds):
        return "unlimited"
    if abs(seconds) < 10 and seconds != round(seconds):
        return f"{seconds:.1f} s"
    whole = round(abs(seconds))
    days, rest = divmod(whole, 86400)
    hours, rest = divmod(rest, 3600)
    minutes, rest = divmod(rest, 60)
    parts = [f"{n} {unit}" for n, unit in ((days, "d"), (hours, "h"), (minutes, "min"), (rest, "s")) if n]
    sign = "-" if seconds < 0 and parts else ""
    return sign + (" ".join(parts) or "0 s")


def clock(seconds: float) -> str:
    """Returns the time since the run began, as `h:mm:ss`."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def celsius(kelvin: float) -> str:
    return number(round(kelvin - ZERO_CELSIUS, 6))


def temperature(segment: Segment) -> str:
    """Returns the temperature of a segment in °C, with the target of a ramp; a dash if the plan holds no temperature."""
    held = "–" if segment.temperature is None else celsius(segment.temperature)
    return held if segment.ramp_to is None else f"{held} → {celsius(segment.ramp_to)}"


def supply(segment: Segment) -> str:
    """Returns the stated supply voltage in V; a dash if the plan states none."""
    return "–" if segment.supply_voltage is None else number(round(segment.supply_voltage, 9))


def pressure(segment: Segment) -> str:
    """Returns the stated ambient pressure in hPa; a dash if the plan states none."""
    return "–" if segment.ambient_pressure is None else number(round(segment.ambient_pressure / 100, 9))


def rate(segment: Segment) -> str:
    """Returns the commanded rate in °/s; a dash if the segment is at rest."""
    return number(round(math.degrees(segment.rate), 9)) if isinstance(segment.motion, Spin) else "–"


def direction(about: tuple[float, float, float]) -> str:
    """Returns a direction at the site, given in East-North-Up, in words."""
    east, north, up = (round(component, 9) + 0.0 for component in about)
    return word_of(about) or f"({east:g} E, {north:g} N, {up:g} U)"


def motion(what: Motion) -> str:
    """Returns the motion of a segment in words."""
    match what:
        case Rest():
            return AT_REST
        case Spin(rate=value, about=about):
            return f"{number(round(math.degrees(value), 9))}°/s about {direction(about)}"
        case Rock():
            phases = ", ".join(f"{number(round(math.degrees(phase), 9))}°" for phase in what.phases)
            size = number(round(math.degrees(what.amplitude), 9))
            text = f"rocking {size}° at {number(what.frequency)} Hz for {duration(what.duration)}"
            text += f", after {duration(what.delay)} at rest" if what.delay else ""
            return f"{text}, phases {phases}" if phases else text
        case RecordedMotion():
            return f"moved as {', '.join(what.channels)} show"
        case Cycle():
            speed = number(round(math.degrees(what.rate), 9))
            return f"{len(what.moves)} moves at {speed}°/s, stops of {duration(what.stop)}"


def orientation(segment: Segment) -> str:
    """Returns the directions of the sensor's axes in words: as written in the plan or, if the plan does not state them, derived
    from the attitude."""
    if segment.orientation:
        return segment.orientation
    return "unknown" if segment.attitude is None else in_words(segment.attitude)
