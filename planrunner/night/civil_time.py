"""Converts the civil time of a night to instants. The windows of a night are stated in local time of day.

Instants are seconds since 1970 UTC, so that durations are correct even if daylight saving begins or ends during the night. A local
time that the clocks skip when they go forward does not exist. Such a time is converted as if the clocks had not gone forward. If a
local time exists twice, because clocks go back, the first instant is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date, datetime, timedelta, tzinfo

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import InputError, Mark
from planrunner.night.suite import DAYS, NightWindow


@dataclass(frozen=True, slots=True)
class Opening:
    """Describes one opening of a window, on one day, from the instant `opens` to the instant `closes`."""

    opens: float
    closes: float


def zone_of(name: str | None, mark: Mark) -> tzinfo | None:
    """Returns the time zone with this name, or the zone of the computer if the name is None. Raises `InputError` if the zone is
    unknown."""
    if name is None:
        return None
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        message = f"there is no time zone '{name}' on this computer"
        raise InputError.at(
            mark, "suite-zone", message, "write a name such as Europe/Berlin or Asia/Shanghai"
        ) from None


def civil(instant: float, zone: tzinfo | None) -> datetime:
    """Converts an instant to local time with its offset from UTC."""
    return datetime.fromtimestamp(instant, zone).astimezone(zone)


def instant_of(day: date, time: str, zone: tzinfo | None) -> float:
    """Converts a local time of day, `HH:MM`, on one day to an instant."""
    hours, minutes = map(int, time.split(":"))
    return datetime(day.year, day.month, day.day, hours, minutes, tzinfo=zone).timestamp()


def openings(window: NightWindow, since: float, zone: tzinfo | None) -> Iterator[Opening]:
    """Yields, in order, the openings of a window that close after the instant `since`."""
    day = civil(since, zone).date() - timedelta(days=1)
    overnight = window.closes <= window.opens
    for _ in range(3 * 366):  # a weekday comes again within a week; the rest is for callers that look further
        if DAYS[day.weekday()] in window.days:
            last = day + timedelta(days=1) if overnight else day
            opening = Opening(instant_of(day, window.opens, zone), instant_of(last, window.closes, zone))
            if opening.closes > since and opening.closes > opening.opens:
                yield opening
        day += timedelta(days=1)


def shown_time(instant: float, zone: tzinfo | None) -> str:
    """Returns date, time and zone as a text, such as `2026-03-28 22:00 CET`."""
    return f"{civil(instant, zone):%Y-%m-%d %H:%M %Z}".rstrip()
