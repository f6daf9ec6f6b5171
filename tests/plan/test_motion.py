"""Motions, above all the indexing cycles: what must land, close and not wind up."""

from __future__ import annotations

import math

import pytest

from planrunner.base.findings import Findings
from planrunner.plan.expand import expand
from planrunner.plan.model import parse_plan
from planrunner.plan.motion import motion_of
from planrunner.plan.schedule import Cycle, Motion, RecordedMotion, Rest, Rock, Spin

HEAD = "planrunner: 1\ntitle: t\nsensor: {kind: k, outputs: [o]}\nsegments:\n"
PRINTED = ["A +180 C", "C +90 D", "D -180 B", "B -90 A", "A -180 C", "C -90 B", "B +180 D", "D +90 A"]


def motion(text: str, dwell: float | None = 600.0) -> tuple[Motion | None, Findings]:
    plan, log = parse_plan(f"{HEAD}  - label: a\n    {text}\n", "f")
    assert plan is not None
    (segment,) = expand(plan, log)
    return motion_of(segment.state, segment.marks, dwell, log), log


def cycle(moves: list[str], more: str = "") -> tuple[Motion | None, Findings]:
    positions = "A: 0 deg, B: 90 deg, C: 180 deg, D: 270 deg"
    listed = "".join(f"\n        - {move}" for move in moves)
    return motion(
        f"motion:\n      cycle: {{{positions}}}\n      turn_rate: 10 deg/s\n      stop: 5 min{more}\n      moves:{listed}"
    )


def test_the_printed_cycle_is_taken() -> None:
    found, log = cycle(PRINTED)
    assert not len(log), list(map(str, log))
    assert isinstance(found, Cycle)
    assert [(move.start, round(math.degrees(move.turn)), move.end) for move in found.moves] == [
        *(("A", 180, "C"), ("C", 90, "D"), ("D", -180, "B"), ("B", -90, "A")),
        *(("A", -180, "C"), ("C", -90, "B"), ("B", 180, "D"), ("D", 90, "A")),
    ]
    assert found.rate == pytest.approx(math.radians(10))
    assert found.stop == 300


def test_clockwise_reverses_every_angle() -> None:
    found, log = cycle(PRINTED, more="\n      sense: clockwise")
    assert not len(log)
    assert isinstance(found, Cycle)
    assert math.degrees(found.positions["B"]) == pytest.approx(-90)
    assert math.degrees(found.moves[1].turn) == pytest.approx(-90)


def test_the_cycle_of_eight_moves_without_residual() -> None:
    turns = [90, 90, -90, -90, -90, -90, 90, 90]
    names, angle, moves = "ABCD", 0, []
    for turn in turns:
        start, angle = names[angle // 90 % 4], angle + turn
        moves.append(f"{start} {turn:+d} {names[angle // 90 % 4]}")
    found, log = cycle(moves)
    assert not len(log)
    assert isinstance(found, Cycle)


@pytest.mark.parametrize(
    ("change", "code", "line", "words"),
    [
        ({2: "D -90 B"}, "meaning-cycle-landing", 13, ["move 3", "ends at 180 deg", "B is at 90 deg"]),
        ({2: "D +170 B"}, "meaning-cycle-landing", 13, ["ends at 80 deg"]),
        ({3: "C -90 B"}, "meaning-cycle-start", 14, ["starts at C", "ends at B"]),
        ({4: "A +180 E"}, "meaning-cycle-position", 15, ["'E'"]),
        ({4: "A +0 A"}, "meaning-cycle", 15, ["move 5", "turns by 0 deg"]),
        ({7: None}, "meaning-cycle-closed", 17, ["starts at A and ends at D"]),
        ({2: "D +180 B"}, "physics-cable-wrap", 11, ["+360 deg"]),
        ({0: "A -180 C"}, "physics-cable-wrap", 11, ["-360 deg"]),
    ],
)
def test_broken_cycles_are_refused_with_figures(
    change: dict[int, str | None], code: str, line: int, words: list[str]
) -> None:
    moves = [change.get(index, move) for index, move in enumerate(PRINTED)]
    found, log = cycle([move for move in moves if move is not None])
    assert found is None
    finding = next(iter(log))
    assert (finding.code, finding.mark.line) == (code, line)
    for word in words:
        assert word in finding.message
    assert finding.hint


def test_every_move_that_lands_wrong_is_named() -> None:
    _, log = cycle(["A +90 C", "C +90 A", "A +10 D"])
    assert [finding.mark.line for finding in log if finding.code == "meaning-cycle-landing"] == [11, 12, 13]
    assert "+180 or -180 deg" in next(iter(log)).hint


@pytest.mark.parametrize("move", ["A 1.2.3 C", "A ... C", "A +180", "+180 C", "A +180 C D", "A +1e3 C", "5"])
def test_what_is_no_move(move: str) -> None:
    _, log = parse_plan(f"{HEAD}  - {{label: a, motion: {{cycle: {{A: 0 deg}}, moves: [{move}]}}}}\n", "f")
    assert [finding.code for finding in log] == ["form-text"]


def test_constant_rates() -> None:
    up = (0.0, 0.0, 1.0)
    assert motion("rate: -30 deg/s")[0] == Spin(math.radians(-30), up)
    assert motion("motion: {rate: 30 deg/s, sense: clockwise}")[0] == Spin(math.radians(-30), up)
    assert motion("motion: {rate: 30 deg/s, about: south}")[0] == Spin(math.radians(30), (0.0, -1.0, 0.0))
    for text in ("rate: 0 deg/s", "motion: {rate: 0 deg/s}", "motion: rest", "dwell: 5 s"):
        assert motion(text)[0] == Rest()


def test_rocking() -> None:
    found, log = motion("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz, phases: [0 deg, 45 deg]}, for: 8 min}")
    assert not len(log)
    assert found == Rock(math.radians(3), 0.2, (0.0, math.radians(45)), 480.0)
    assert motion("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}}")[0] == Rock(
        math.radians(3), 0.2, (0.0,), 600.0
    )
    assert motion("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}}", None)[0] == Rock(
        math.radians(3), 0.2, (0.0,), math.inf
    )


def test_rocking_that_begins_within_the_dwell() -> None:
    rock = "rock: {amplitude: 3 deg, frequency: 0.2 Hz}"
    assert motion(f"motion: {{{rock}, after: 60 s, for: 8 min}}")[0] == Rock(math.radians(3), 0.2, (0.0,), 480.0, 60.0)
    found = motion(f"motion: {{{rock}, after: 60 s}}")[0]
    assert isinstance(found, Rock)
    # 60 s at rest, 5 s to fade in, and the rest of 10 min
    assert (found.lead_in, found.steady, found.duration, found.over) == (0.0, 65.0, 535.0, 605.0)


@pytest.mark.parametrize(
    ("text", "code", "at"),
    [
        ("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}, after: 2 min, for: 8 min}", "meaning-rock", "8 min"),
        ("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}, after: 10 min}", "meaning-rock", "10 min"),
        ("motion: {rate: 5 deg/s, after: 8 min}", "meaning-motion", "8 min"),
        ("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}, for: 11 min}", "meaning-rock", "11 min"),
        ("motion: {rate: 5 deg/s, for: 8 min}", "meaning-motion", "8 min"),
        ("motion: {rate: 5 deg/s, stop: 8 min}", "meaning-motion", "8 min"),
        ("motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}, sense: clockwise}", "meaning-motion", "clockwise"),
        ("motion: {}", "meaning-motion", "{}"),
        ("motion: {rate: 5 deg/s, cycle: {A: 0 deg}}", "meaning-motion", "{rate"),
        ("motion: {cycle: {A: 0 deg}}", "meaning-cycle", "{cycle"),
    ],
)
def test_motions_that_make_no_sense(text: str, code: str, at: str) -> None:
    found, log = motion(text)
    assert found is None
    finding = next(iter(log))
    assert (finding.code, finding.mark.line, finding.mark.column) == (code, 6, text.index(at) + 5)
    assert finding.hint


def test_what_could_not_be_read_of_a_motion_is_not_also_missing() -> None:
    """Said once, where it stands: not as a motion that is neither rate nor rock nor cycle, in an alias either."""
    rocking = "{rock: {amplitude: 0 deg, frequency: 1 Hz}}"
    plan, log = parse_plan(f"{HEAD}  - {{label: a, motion: &m {rocking}}}\n  - {{label: b, motion: *m}}\n", "f")
    assert plan is not None
    for segment in expand(plan, log):
        assert motion_of(segment.state, segment.marks, 600.0, log) is None
    assert [item.code for item in log.errors] == ["meaning-range"]


def test_a_motion_that_the_recording_shows() -> None:
    found, log = motion("motion: {recorded: {rates: [a, b, c], forces: [d, e, f], averaging: 20 ms}}", None)
    assert not len(log) and found == RecordedMotion(rates=("a", "b", "c"), forces=("d", "e", "f"), averaging=0.02)
    found, log = motion("motion: {about: north, sense: clockwise, recorded: {angle: encoder}}", None)
    assert not len(log) and isinstance(found, RecordedMotion)
    assert found.angle == "encoder" and found.about == (0.0, -1.0, 0.0)


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("recorded: {angle: e, rates: [a, b, c]}", "meaning-recorded-motion", "angle and rates"),
        ("recorded: {averaging: 1 s}", "meaning-recorded-motion", "none of them"),
        ("recorded: {angle: e, forces: [a, b, c]}", "meaning-recorded-motion", "does not determine the specific force"),
        (
            "recorded: {rates: [a, b, c]}\n      about: north",
            "meaning-motion",
            "'about' has no meaning without `angle`",
        ),
        ("recorded: {rates: [a, b, c]}\n      rate: 3 deg/s", "meaning-motion", "exactly one of the keys"),
    ],
)
def test_a_recorded_motion_says_once_what_shows_it(text: str, code: str, words: str) -> None:
    found, log = motion(f"motion:\n      {text}", None)
    assert found is None
    assert [(one.code, words in one.message) for one in log] == [(code, True)]
