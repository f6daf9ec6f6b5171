"""Durations in words, for reasons and reports of a night."""

from __future__ import annotations


def spell_out(seconds: float) -> str:
    """A duration in words: `3484` → `58 min`; minutes, and seconds only below two minutes."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours and minutes else f"{hours} h" if hours else f"{minutes} min"
