"""Draws a recording whose motion is not described yet: levels over time, with the intervals at rest shaded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from planrunner.reporting.plots import COLOURS, drawing, thinned

if TYPE_CHECKING:
    from planrunner.instruments.recording_look import LikelyChannel, Look

_SHOWN = 6  # channels of a kind


def recording_picture(look: Look) -> str:
    """Makes an SVG file with one chart for each kind of channel."""
    kinds = [kind for kind in ("accel", "gyro", "temperature") if any(one.sensed == kind for one in look.channels)]
    with drawing(9.0, 0.6 + 2.2 * max(len(kinds), 1)) as (figure, save):
        for place, kind in enumerate(kinds):
            axes = figure.add_subplot(len(kinds), 1, place + 1)
            shown = [one for one in look.channels if one.sensed == kind][:_SHOWN]
            for colour, one in zip(COLOURS * 2, shown, strict=False):
                level = look.windows.mean[one.column] / one.per_unit
                chosen = thinned(level)
                axes.plot(look.windows.begin[chosen], level[chosen], color=colour, linewidth=0.9, label=one.name)
            for span in look.still:
                axes.axvspan(span.start, span.end, color="#5f6b76", alpha=0.12, linewidth=0)
            axes.set_ylabel(_title(shown))
            axes.legend(loc="upper right", ncols=3)
        figure.axes[-1].set_xlabel("time [s]; shaded: still")
        svg = save("recording", f"Recording {look.file}", f"Means over {look.windows.length:g} s of {', '.join(kinds)}")
    return svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1) if "xmlns=" not in svg else svg


def _title(shown: Sequence[LikelyChannel]) -> str:
    units = dict.fromkeys(one.unit for one in shown)
    return f"{shown[0].sensed} [{', '.join(units)}]"
