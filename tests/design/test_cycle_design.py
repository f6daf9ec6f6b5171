"""`planrunner design` of rotation cycles: the searches against enumeration and hand-worked sums; what is printed, written and refused."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from planrunner.cli import main
from planrunner.design.cycles import Cable, CycleError, free_order, same_order
from planrunner.design.study import Asked
from planrunner.estimators.interface import EstimationError
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.rewriting import RewriteError, with_moves
from planrunner.tasks.check import check_plan
from planrunner.tasks.design_cycles import design_cycle

DEG = math.pi / 180
PRINTED = (180, 90, -180, -90, -180, -90, 180, 90)
MIRRORED = (-180, 90, 180, -90, 180, -90, -180, 90)
EIGHT = (90, 90, -90, -90, -90, -90, 90, 90)
FOUR = [0.0, 90 * DEG, 180 * DEG, 270 * DEG]

PLAN = """\
planrunner: 1
title: a cycle
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
defaults: {orientation: {x: east, y: north, z: up}}
segments:
  - {label: still, dwell: 1 h}
  - label: navigate
    dwell: {cycles: 4}
    motion:
      sense: clockwise
      cycle: {A: 0 deg, B: 90 deg, C: 180 deg, D: 270 deg}
      moves:  # as printed
        - A +180 C
        - C +90 D
        - D -180 B
        - B -90 A
        - A -180 C
        - C -90 B
        - B +180 D
        - D +90 A
      # how fast
      turn_rate: 10 deg/s
      stop: 3 min
"""


def cycle(turns: tuple[int, ...], acceleration: float = 5) -> RotationCycle:
    return RotationCycle(tuple(turn * DEG for turn in turns), 180.0, 10 * DEG, acceleration * DEG)


def degrees(one: RotationCycle | None) -> tuple[int, ...]:
    assert one is not None
    return tuple(round(math.degrees(turn)) for turn in one.turns)


def left(turns: tuple[int, ...]) -> complex:
    """What turns without ramps leave, in units of 1/rate, by hand: every turn from a to b leaves (e^ib − e^ia)/(±i)."""
    total, angle = 0j, 0
    for turn in turns:
        begin, end = (1j ** (at // 90 % 4) for at in (angle, angle + turn))
        total += (end - begin) / 1j * (1 if turn > 0 else -1)
        angle += turn
    return total


@pytest.mark.parametrize("acceleration", [math.inf, 5])
def test_the_planned_order_needs_sixteen_moves(acceleration: float) -> None:
    found = same_order(cycle(PRINTED, acceleration))
    assert degrees(found.cycle) == (*PRINTED, *MIRRORED)
    eight, sixteen = found.rounds
    assert (eight.moves, eight.tried, eight.balanced, eight.wound) == (8, 16, 4, 4)
    assert sixteen.moves == 16
    # The same by hand: of all directions of the four half turns, those that leave nothing wind up by a turn.
    halves = [index for index, turn in enumerate(PRINTED) if abs(turn) == 180]
    sums = []
    for signs in itertools.product((180, -180), repeat=4):
        turns = list(PRINTED)
        for index, turn in zip(halves, signs, strict=True):
            turns[index] = turn
        if abs(left(tuple(turns))) < 1e-12:
            sums.append(sum(turns))
    assert len(sums) == 4
    assert set(map(abs, sums)) == {360}
    assert left((*PRINTED, *MIRRORED)) == 0


@pytest.mark.parametrize("acceleration", [math.inf, 5])
def test_with_a_free_order_eight_moves_suffice(acceleration: float) -> None:
    found = free_order(FOUR, cycle(PRINTED, acceleration))
    assert degrees(found.cycle) == EIGHT
    four, eight = found.rounds
    assert (four.moves, four.balanced, four.wound) == (4, 2, 2)  # all the way round, either way
    assert eight.moves == 8 and eight.exhaustive


def test_no_cycle_of_eight_moves_needs_less_cable() -> None:
    narrow = []
    for turns in itertools.product((90, -90, 180, -180), repeat=8):
        angles = np.cumsum((0, *turns))
        visits = np.bincount(angles[:-1] // 90 % 4, minlength=4)
        if angles[-1] == 0 and (visits == 2).all() and angles.max() - angles.min() < 360 and abs(left(turns)) < 1e-12:
            narrow.append(turns)
    assert not narrow


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 6, 8])
def test_other_numbers_of_positions(count: int) -> None:
    angles = [index * 2 * math.pi / count for index in range(count)]
    one = free_order(angles, cycle(PRINTED)).cycle
    assert one is not None
    assert one.balanced
    assert abs(one.net_turn) < 1e-9
    assert abs(one.mean_angle) < 1e-9
    held = np.bincount(np.rint(one.stops / (2 * math.pi / count)).astype(int) % count)
    assert len(held) == count and len(set(held.tolist())) == 1
    # What is left, integrated as a sum of samples of the course.
    times = (np.arange(400_000) + 0.5) * one.period / 400_000
    assert abs(np.mean(np.exp(1j * one.angle(times)))) < 1e-6


def test_cables_that_allow_less() -> None:
    short = Cable(-200 * DEG, 200 * DEG)
    assert same_order(cycle(PRINTED), short).cycle is None  # the order itself winds to 270 deg
    assert degrees(free_order(FOUR, cycle(PRINTED), short).cycle) == EIGHT
    assert free_order(FOUR, cycle(PRINTED), Cable(-100 * DEG, 100 * DEG)).cycle is None


def test_what_no_turns_can_mend() -> None:
    with pytest.raises(CycleError, match="stop times on opposite sides differ"):
        same_order(cycle((90, 90, -90, -90)))
    with pytest.raises(CycleError, match="0, 90, 180 deg do not balance"):
        free_order([0.0, 90 * DEG, 180 * DEG], cycle((90, 90, -90, -90)))
    with pytest.raises(CycleError, match="one position"):
        free_order([0.0, 2 * math.pi], cycle((360, -360)))


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return path


def test_the_command_compares_prints_and_writes(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, better = plan.with_name("page.html"), plan.with_name("better.yaml")
    assert main(["design", str(plan), "--html", str(page), "--write", str(better)]) == 0
    output = capsys.readouterr().out
    assert "-22.92 s" in output and "-270 … 270" in output and "-180 … 180" in output
    assert (
        "with 8 moves, no suitable cycle was found, because every cycle with a zero residual winds up the cables"
        in output
    )
    text = better.read_text(encoding="utf-8")
    assert "[A +90 B, B +90 C, C -90 B, B -90 A, A -90 D, D -90 C, C +90 D, D +90 A]" in text
    assert "# as printed" in text and "# how fast" in text and "D -180 B" not in text
    checked = check_plan(better)
    assert checked.ok and not len(checked.findings)
    html = page.read_text(encoding="utf-8")
    assert "<svg" in html and "The table’s angle" in html and "http://" not in html.replace("http://www.w3.org", "")


def test_the_same_order_can_be_written(plan: Path) -> None:
    better = plan.with_name("better.yaml")
    assert (
        main(["design", str(plan), "--segment", "navigate", "--order", "same", "--write", str(better), "--json"]) == 0
    )
    assert better.read_text(encoding="utf-8").count("A +180 C") == 2
    assert not len(check_plan(better).findings)


def test_the_study_as_data(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", str(plan), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["segment"] == "navigate"
    assert set(data["cycles"]) == {"planned", "same order", "free order"}
    assert data["cycles"]["planned"]["turns_leave_s"][0] == pytest.approx(-22.92, abs=5e-3)
    assert data["cycles"]["free order"]["reach_deg"] == pytest.approx([-180, 180])


@pytest.mark.parametrize(
    ("replacement", "arguments", "words"),
    [
        (
            ("label: navigate", "label: turn"),
            ["--segment", "navigate"],
            "no segment 'navigate' has a cycle; these do: turn",
        ),
        (("C: 180 deg", "C: 185 deg"), [], "does not end at its position"),
        (("    motion:", "    rate: 10 deg/s\n    motion:"), [], "rate"),
    ],
)
def test_what_cannot_be_designed(
    replacement: tuple[str, str], arguments: list[str], words: str, plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan.write_text(PLAN.replace(*replacement), encoding="utf-8")
    assert main(["design", str(plan), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_plan_without_a_cycle_has_none_to_design(tmp_path: Path) -> None:
    path = tmp_path / "still.yaml"
    path.write_text(PLAN[: PLAN.index("  - label: navigate")], encoding="utf-8")
    with pytest.raises(EstimationError, match="no segment of the plan has a cycle"):
        design_cycle(check_plan(path), Asked())


@pytest.mark.slow
def test_positions_that_are_not_round_figures(plan: Path) -> None:
    angles = [round(index * 360 / 7, 4) for index in range(7)]
    cycle = ", ".join(f"P{index}: {angle} deg" for index, angle in enumerate(angles))
    ends = [*angles, 0.0]
    forth = [f"P{index} {ends[index + 1] - ends[index]:+.4f} P{index + 1}" for index in range(6)]
    moves = [*forth, f"P6 {-angles[6]:+.4f} P0"]
    start, end = PLAN.index("      cycle:"), PLAN.index("      # how fast")
    plan.write_text(
        f"{PLAN[:start]}      cycle: {{{cycle}}}\n      moves: [{', '.join(moves)}]\n{PLAN[end:]}", encoding="utf-8"
    )
    better = plan.with_name("better.yaml")
    assert main(["design", str(plan), "--write", str(better), "--quiet"]) == 0
    checked = check_plan(better)
    assert checked.ok
    assert "physics-cycle-residual" not in [finding.code for finding in checked.findings]


def test_unbalanced_stops_are_reported_and_the_free_order_still_found(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, tail = PLAN[: PLAN.index("      moves:")], PLAN[PLAN.index("      # how fast") :]
    plan.write_text(head + "      moves: [A +90 B, B +90 C, C +90 D, D -270 A, A +90 B, B -90 A]\n" + tail)
    assert main(["design", str(plan)]) == 0
    output = capsys.readouterr().out
    assert "the stop times on opposite sides differ" in output and "free order of stops" in output
    assert main(["design", str(plan), "--order", "same", "--write", str(plan.with_name("w.yaml"))]) == 2
    assert "a cycle with the same order of stops" in capsys.readouterr().err


def test_moves_written_in_place() -> None:
    text = "a:\n  moves: [x, y]  # kept\nb: 1\n"
    assert with_moves(text, (2, 10), ["A 1 B"]) == "a:\n  moves: [A 1 B]  # kept\nb: 1\n"
    with pytest.raises(RewriteError, match="line 1"):
        with_moves(text, (1, 1), ["A 1 B"])
