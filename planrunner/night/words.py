"""Writes durations in words, for the reasons and reports of a night."""

from __future__ import annotations


def spell_out(seconds: float) -> str:
    """Writes a duration in words, such as `58 min` for `3484`. A duration below two minutes is written in seconds; a longer
    duration is written in hours and minutes."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours and minutes else f"{hours} h" if hours else f"{minutes} min"
