"""The `show` page and its sums, by hand."""

from __future__ import annotations

import numpy as np
import reporting_example as example

from planrunner.estimators.interface import Design
from planrunner.plan.schedule import Cycle, Move, Rest, Rock, Schedule, Segment, Spin
from planrunner.reporting import words
from planrunner.reporting.show_page import (
    ShowContext,
    labels_in_short,
    orientations,
    render_show,
    show_view,
    timeline_table,
    totals,
)


def test_totals_by_hand() -> None:
    facts = totals(example.schedule())
    # 19 × 120 s recording; 600 s + 19 × 30 s waiting; 1500 s + 18 × 11.2 s moving; 60 s to the safe state.
    assert facts["recording"] == "38 min"
    assert facts["soaking and settling"] == "19 min 30 s"
    assert facts["moving and changing temperature"] == "28 min 22 s"
    assert facts["total time"] == "1 h 26 min 52 s"
    assert facts["temperature"] == "25 °C"
    assert "rates" not in facts
    thermal = totals(example.thermal_schedule())
    assert thermal["temperature"] == "-40 °C to 60 °C"
    assert thermal["rates"] == "1 to 300 °/s in both directions"
    assert thermal["orientations"] == "1 (x east, y north, z up)"


def test_every_orientation_is_pictured_once() -> None:
    # Nineteen positions, of which T2 repeats P7 and T3 repeats P6.
    groups = orientations(example.schedule().segments)
    assert len(groups) == 17
    assert ["P7", "T2"] in [[item.label for item in group] for group in groups]
    view = show_view(ShowContext("t", example.schedule()))
    assert len(view["pictures"]) == 17
    page = render_show(ShowContext("t", example.schedule()))
    assert page.count('class="orientation"') == 17
    assert "P7, T2" in page


def test_idle_columns_are_left_out() -> None:
    assert "Rate about up [°/s]" in timeline_table(example.thermal_schedule()).headings
    assert not [title for title in timeline_table(example.schedule()).headings if title.startswith(("Rate", "Motion"))]
    bare = Schedule((Segment(0, "only", None, "unknown", Rest(), None),), 0.0)
    assert timeline_table(bare).headings == (
        "#",
        "Start [h:mm:ss]",
        "Segment",
        "Orientation",
        "Reach [s]",
        "Dwell",
        "End [h:mm:ss]",
    )
    assert timeline_table(bare).rows == (("1", "0:00:00", "only", "unknown", "0", "as recorded", "–"),)


def test_recorded_dwells_and_unknown_orientations_make_a_page() -> None:
    bare = Schedule((Segment(0, "only", None, "unknown", Rest(), None),), 0.0)
    page = render_show(ShowContext("t", bare, designs={"d": Design((), ("a note",))}))
    assert "plus the length of the recordings" in page
    assert "a note" in page
    assert render_show(ShowContext("t", Schedule((), 0.0)))


def test_motions_in_words() -> None:
    turn = np.radians(180)
    assert words.motion(Rest()) == "rest"
    assert words.motion(Spin(np.radians(-20))) == "-20°/s about up"
    assert words.motion(Spin(np.radians(20), (0.0, -1.0, 0.0))) == "20°/s about south"
    assert (
        words.motion(Rock(np.radians(3), 0.2, (0.0, np.radians(45)), 480))
        == "rocking 3° at 0.2 Hz for 8 min, phases 0°, 45°"
    )
    cycle = Cycle({"A": 0.0, "C": turn}, (Move("A", turn, "C"), Move("C", -turn, "A")), np.radians(10), 300)
    assert words.motion(cycle) == "2 moves at 10°/s, stops of 5 min"


def test_times_in_words() -> None:
    assert words.duration(95) == "1 min 35 s"
    assert words.duration(90061) == "1 d 1 h 1 min 1 s"
    assert words.duration(0) == "0 s"
    assert words.duration(7.25) == "7.2 s"
    assert words.duration(59.7) == "1 min"
    assert words.clock(3661.4) == "1:01:01"
    assert words.number(3.1e-06) == "3.1e-6"
    assert words.number(-0.0) == "0"
    assert words.number(1.5e10) == "1.5e10"


def test_labels_in_short() -> None:
    assert labels_in_short(["a", "b", "a"]) == "a, b"
    assert labels_in_short(list("abcdefg")) == "a, b, c and 4 more"
