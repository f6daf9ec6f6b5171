"""Sweeps, inheritance, repeats and labels: from nested segments to the list that is carried out."""

from __future__ import annotations

import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planrunner.base.findings import Findings
from planrunner.plan.expand import MAX_SEGMENTS, StatedSegment, expand
from planrunner.plan.model import parse_plan
from planrunner.plan.quantity import Quantity
from planrunner.plan.rewriting import with_rates

HEAD = "planrunner: 1\ntitle: t\nsensor: {kind: k, outputs: [o]}\n"


def stated(segments: str, head: str = HEAD) -> tuple[list[StatedSegment], Findings]:
    plan, log = parse_plan(f"{head}segments:\n{segments}", "f")
    assert plan is not None, list(map(str, log))
    return expand(plan, log), log


def labels(segments: str, head: str = HEAD) -> list[str]:
    found, log = stated(segments, head)
    assert not len(log), list(map(str, log))
    return [item.label for item in found]


def test_the_first_key_changes_slowest() -> None:
    found = labels("  - for_each: {temperature: [20 degC, 60 degC], rate: ±1 deg/s}\n")
    assert found == ["20degC/+1deg_s", "20degC/-1deg_s", "60degC/+1deg_s", "60degC/-1deg_s"]


@pytest.mark.parametrize(
    ("order", "expected"),
    [
        ("as_written", ["1s/1K", "1s/2K", "1s/3K", "2s/1K", "2s/2K", "2s/3K"]),
        ("reversed", ["2s/3K", "2s/2K", "2s/1K", "1s/3K", "1s/2K", "1s/1K"]),
        ("serpentine", ["1s/1K", "1s/2K", "1s/3K", "2s/3K", "2s/2K", "2s/1K"]),
    ],
)
def test_orders(order: str, expected: list[str]) -> None:
    assert labels(f"  - {{for_each: {{soak: '1, 2 s', temperature: '1, 2, 3 K'}}, order: {order}}}\n") == expected


def test_serpentine_changes_one_key_at_a_time() -> None:
    found = labels(
        "  - {for_each: {soak: '1, 2, 3 s', settle: '1, 2 s', temperature: '1, 2, 3 K'}, order: serpentine}\n"
    )
    rows = [label.split("/") for label in found]
    assert len({tuple(row) for row in rows}) == 18
    assert all(sum(a != b for a, b in zip(one, two, strict=True)) == 1 for one, two in pairwise(rows))


def test_shuffled_is_reproducible_and_loses_nothing() -> None:
    def shuffled(seed: int) -> list[str]:
        values = ", ".join(map(str, range(1, 21)))
        return labels(f"  - {{for_each: {{temperature: '{values} K'}}, order: shuffled, shuffle_seed: {seed}}}\n")

    assert shuffled(7) == shuffled(7)
    assert shuffled(7) != shuffled(8)
    assert sorted(shuffled(7)) == sorted(shuffled(8)) == sorted(f"{n}K" for n in range(1, 21))


def test_signs_in_lists_and_their_labels() -> None:
    assert labels("  - for_each: {rate: [±300 deg/s, 0 deg/s, ±0.5 deg/s]}\n") == [
        *("+300deg_s", "-300deg_s", "0deg_s", "+0.5deg_s", "-0.5deg_s"),
    ]


@pytest.mark.parametrize(
    ("swept", "expected"),
    [
        ("temperature: '-40, 20, 60 degC'", ["-40degC", "20degC", "60degC"]),
        ("temperature: '20, 60 degC'", ["20degC", "60degC"]),
        ("temperature: ['-0 degC', '+5 degC', '−5 degC']", ["0degC", "5degC", "-5degC"]),
        ("temperature: ['0 degF', '+41 degF', '-4 degF']", ["0degF", "41degF", "-4degF"]),
        ("rate: '10, 20 deg/s'", ["+10deg_s", "+20deg_s"]),
        ("rate: ['0 deg/h', '-0 deg/s', ±0 rad/s]", ["0deg_h", "0deg_s", "0rad_s"]),
        ("rate: [-10 deg/s, -20 deg/s]", ["-10deg_s", "-20deg_s"]),
        ("rate: {slow: -10 deg/s, '+fast': 20 deg/s}", ["slow", "+fast"]),
        ("dwell: '10, 20 s'", ["10s", "20s"]),
    ],
)
def test_a_rate_has_its_sign_other_quantities_a_minus_and_zero_none(swept: str, expected: list[str]) -> None:
    assert labels(f"  - for_each: {{{swept}}}\n") == expected


@given(
    st.sampled_from(["rate", "temperature"]),
    st.lists(st.integers(-200, 200), min_size=1, max_size=6, unique=True),
    st.booleans(),
)
def test_a_value_keeps_its_label_whatever_stands_beside_it(key: str, values: list[int], nested: bool) -> None:
    unit = {"rate": "deg/s", "temperature": "degC"}[key]

    def swept(chosen: list[int]) -> list[str]:
        text = f"for_each: {{{key}: '{', '.join(map(str, chosen))} {unit}'}}, label: 'T{{{key}}}'"
        return labels(f"  - {{label: outer, steps: [{{{text}}}]}}\n" if nested else f"  - {{{text}}}\n")

    together = swept(values)
    assert together == [label for value in values for label in swept([value])]
    for label, value in zip(together, values, strict=True):
        figure = label.rpartition("T")[2]
        assert int(figure) == value
        assert ("+" in figure) == (key == "rate" and value > 0)


def test_a_figure_in_a_label_has_the_same_sign() -> None:
    assert labels("  - {for_each: {rate: ['±5 deg/s', '0 deg/s']}, label: 'R{rate}'}\n") == ["R+5", "R-5", "R0"]
    assert labels("  - {for_each: {temperature: '-5, 0, 5 degC'}, label: 'T{temperature}'}\n") == ["T-5", "T0", "T5"]


def test_a_sweep_written_once_a_rate_keeps_its_labels() -> None:
    text = HEAD + "segments:\n  - for_each: {rate: '3, 1, -1 deg/s'}\n    label: R{rate}\n"
    (line, column), rates = (5, 22), ["3 deg/s", "1 deg/s", "-1 deg/s"]
    found = []
    for written in (text, with_rates(text, (line, column), rates, [5, 6, 6])):
        plan, log = parse_plan(written, "f")
        assert plan is not None
        found.append([item.label for item in expand(plan, log)])
        assert not len(log), list(map(str, log))
    assert found[0] == found[1]


def test_equal_values_get_labels_of_their_own() -> None:
    assert labels("  - for_each: {temperature: '20, 60, 20 degC'}\n") == ["20degC", "60degC", "20degC#2"]


def test_names_become_labels() -> None:
    assert labels(
        "  - for_each: {orientation: {P1: {x: up, y: north}, P2: unknown}, dwell: {short: 1 s, long: 2 s}}\n"
    ) == [
        *("P1/short", "P1/long", "P2/short", "P2/long"),
    ]


def test_values_without_a_figure_are_counted() -> None:
    assert labels("  - for_each: {orientation: [unknown, {x: up, y: north}]}\n") == ["orientation1", "orientation2"]


def test_placeholders() -> None:
    assert labels(
        "  - {for_each: {rate: '±5 deg/s', temperature: 20 degC}, label: 'R{rate} at {temperature}', repeat: 2}\n"
    ) == [
        *("R+5 at 20/r1", "R-5 at 20/r1", "R+5 at 20/r2", "R-5 at 20/r2"),
    ]
    assert labels("  - {label: 'run {repeat}', repeat: 2}\n") == ["run 1", "run 2"]


def test_an_unknown_placeholder() -> None:
    _, log = stated("  - {label: 'R{rat}', for_each: {rate: 5 deg/s}}\n")
    (finding,) = log
    assert (finding.code, finding.mark.line) == ("meaning-label", 5)
    assert "'rate'" in finding.hint


def test_nested_steps_inherit_and_override() -> None:
    head = HEAD + "defaults: {settle: 30 s, dwell: 2 min, orientation: unknown}\n"
    found, log = stated(
        "  - for_each: {temperature: [20 degC]}\n"
        "    soak: 60 min\n"
        "    steps:\n"
        "      - {label: a, dwell: 60 s}\n"
        "      - {label: b, steps: [{label: c, settle: 1 s}]}\n",
        head,
    )
    assert not len(log)
    assert [item.label for item in found] == ["20degC/a", "20degC/b/c"]
    first, second = found

    def seconds(item: StatedSegment, key: str) -> float:
        value = getattr(item.state, key)
        assert isinstance(value, Quantity)
        return value.value

    assert [seconds(first, key) for key in ("soak", "settle", "dwell")] == [3600, 30, 60]
    assert [seconds(second, key) for key in ("soak", "settle", "dwell")] == [3600, 1, 120]
    assert first.marks["settle"].line == 4
    assert first.marks["temperature"].line == 6
    assert first.marks["dwell"].line == 9
    assert second.marks["settle"].line == 10


def test_a_rate_replaces_an_inherited_motion_and_the_other_way_round() -> None:
    head = HEAD + "defaults: {rate: 5 deg/s}\n"
    nested = "  - {label: b, motion: rest, steps: [{label: c, rate: 1 deg/s}]}\n"
    found, log = stated(f"  - {{label: a, motion: rest}}\n{nested}  - {{label: d}}\n", head)
    assert not len(log)
    assert [[key for key in ("motion", "rate") if getattr(item.state, key) is not None] for item in found] == [
        ["motion"],
        ["rate"],
        ["rate"],
    ]
    assert "rate" not in found[0].marks


@pytest.mark.parametrize(
    ("segments", "code", "line", "column"),
    [
        ("  - {label: a, rate: 1 deg/s, motion: rest}\n", "meaning-motion", 5, 41),
        ("  - {rate: 1 deg/s, for_each: {rate: 1 deg/s}}\n", "meaning-swept-twice", 5, 12),
        ("  - {motion: rest, for_each: {rate: 1 deg/s}}\n", "meaning-swept-twice", 5, 14),
        ("  - for_each: {rate: 1 deg/s, motion: {m: rest}}\n", "meaning-swept-twice", 5, 45),
        ("  - {dwell: 5 s}\n", "meaning-label", 5, 5),
        ("  - {label: a}\n  - {label: a}\n", "meaning-label-repeated", 6, 5),
        (
            "  - {label: a, repeat: 10000, steps: [{label: b, repeat: 10000, steps: [{label: c}]}]}\n",
            "limit-segments",
            5,
            5,
        ),
        (
            "  - {label: a, repeat: 10000, steps: [{label: b, repeat: 10000, steps: [{dwell: 0 s}]}]}\n",
            "meaning-range",
            5,
            85,
        ),
    ],
)
def test_what_makes_no_sense(segments: str, code: str, line: int, column: int) -> None:
    _, log = stated(segments)
    finding = next(iter(log)) if code != "meaning-range" else next(item for item in log if item.code == code)
    assert (finding.code, finding.mark.line) == (code, line)
    assert (
        finding.mark.column == segments.split("\n")[line - 5].find("motion") + 9 if code == "meaning-motion" else True
    )
    assert finding.hint


def test_both_rate_and_motion_in_defaults() -> None:
    _, log = stated("  - {label: a}\n", HEAD + "defaults: {rate: 1 deg/s, motion: rest}\n")
    assert [(item.code, item.mark.line) for item in log] == [("meaning-motion", 4)]


def test_repeated_labels_are_one_finding_a_place() -> None:
    _, log = stated("  - for_each: {temperature: '1, 2, 3 K'}\n  - for_each: {temperature: '1, 2, 3 K'}\n")
    (finding,) = log
    assert "'1K' (and 2 more)" in finding.message
    assert "line 5" in finding.message


def test_the_sound_neighbours_of_a_broken_step_are_expanded() -> None:
    steps = "    steps:\n      - {label: b, dwell: 5 apples}\n      - {label: c}\n"
    found, log = stated(f"  - label: a\n{steps}  - {{label: d, dwell: 0 s}}\n  - {{label: e}}\n")
    assert [item.label for item in found] == ["a/c", "e"]
    assert [(item.code, item.mark.line) for item in log] == [("meaning-unit", 7), ("meaning-range", 9)]


def test_expansion_is_bounded_in_time() -> None:
    start = time.process_time()
    found, _ = stated(f"  - {{label: a, repeat: {MAX_SEGMENTS}}}\n")
    assert len(found) == MAX_SEGMENTS
    _, log = stated("  - " + "{label: a, repeat: 10000, steps: [" * 12 + "{label: b}" + "]}" * 12 + "\n")
    assert [item.code for item in log] == ["limit-segments"]
    assert time.process_time() - start < 5.0


def test_segments_that_inherit_something_unreadable_are_marked() -> None:
    head = HEAD + "defaults: {orientation: {x: up, y: up}, settle: 5 apples, dwell: 5 s}\n"
    found, log = stated("  - {label: a}\n  - {label: b, orientation: unknown}\n", head)
    assert [item.code for item in log] == ["meaning-orientation", "meaning-unit"]
    assert [(item.label, item.sound, item.state.orientation is not None) for item in found] == [
        ("a", False, False),
        ("b", True, True),
    ]
