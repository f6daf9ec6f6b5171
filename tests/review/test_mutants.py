"""Mutants of the shipped plans: each has one change of meaning and any spelling, and exactly this change is named.

`PLANRUNNER_FUZZ=5000` sets the number of mutants.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
from respelling import STYLES, with_keys_shuffled, with_other_units, written_out
from test_meaning import SHIPPED

from planrunner.base.findings import InputError
from planrunner.plan.model import parse_plan
from planrunner.review.difference import MeaningDifference, difference
from planrunner.review.meaning import Meaning, meaning_of_plan

MUTANTS = int(os.environ.get("PLANRUNNER_FUZZ", "150"))
Named = Callable[[MeaningDifference], bool]


@cache
def used() -> tuple[tuple[str, dict[str, Any]], ...]:
    """Texts of the shipped plans that estimate something, and the same as plain data with a segment for each dwell."""
    found = []
    for path in SHIPPED:
        text = path.read_text(encoding="utf-8")
        whole = written_out(text) if "order:" not in text else None
        if whole is not None and "estimates" in whole and 1 < len(whole["segments"]) <= 60:
            found.append((text, whole))
    return tuple(found)


def bases() -> tuple[dict[str, Any], ...]:
    return tuple(whole for _, whole in used())


def copied(data: Any) -> Any:
    if isinstance(data, dict):
        return {name: copied(item) for name, item in data.items()}
    return [copied(item) for item in data] if isinstance(data, list) else data


def read(data: Any, rng: random.Random) -> Meaning | None:
    """The meaning of a plan in some spelling; None if it is not sound."""
    spelt = rng.choice(STYLES)(with_keys_shuffled(with_other_units(data, rng), rng), rng)
    plan, log = parse_plan(spelt, "mutant")
    if plan is None or log.errors:
        return None
    try:
        return meaning_of_plan(plan)
    except InputError:
        return None


def only_segment(label: str, key: str) -> Named:
    """The only change is one of this key in this segment."""

    def named(found: MeaningDifference) -> bool:
        if found.parts or found.limits or found.bench or len(found.segments) != 1:
            return False
        (item,) = found.segments
        same = item.before == item.after == label and not item.moved
        return same and {change.place[0] for change in item.changes} == {key}

    return named


def only_part(*place: str) -> Named:
    def named(found: MeaningDifference) -> bool:
        changes = (*found.parts, *found.limits, *found.bench)
        return not found.segments and bool(changes) and all(change.place[: len(place)] == place for change in changes)

    return named


def a_quantity(data: Any, rng: random.Random) -> Named:
    key = rng.choice(("dwell", "settle", "soak", "temperature", "sample_rate"))
    segment = rng.choice(data["segments"])
    unit = {"temperature": "degC", "sample_rate": "Hz"}.get(key, "s")
    segment[key] = f"{rng.randint(1000, 9999) / 100} {unit}"
    return only_segment(segment["label"], key)


def an_orientation(data: Any, rng: random.Random) -> Named:
    segment = rng.choice(data["segments"])
    segment["orientation"] = {"from": {"x": "up", "y": "north"}, "rotate": [f"z {rng.randint(1, 89)} deg"]}
    return only_segment(segment["label"], "orientation")


def a_motion(data: Any, rng: random.Random) -> Named:
    segment = rng.choice(data["segments"])
    for key in ("rate", "motion"):
        segment.pop(key, None)
    segment["dwell"] = segment["dwell"] if isinstance(segment["dwell"], str) else "1 min"
    segment["motion"] = {
        "rate": f"{rng.randint(1, 9)}.125 deg/s",
        "sense": rng.choice(("clockwise", "counterclockwise")),
    }
    return lambda found: (
        len(found.segments) == 1
        and found.segments[0].after == segment["label"]
        and {change.place[0] for change in found.segments[0].changes} - {"dwell"} == {"motion"}
    )


def a_word(data: Any, rng: random.Random) -> Named:
    segment = rng.choice(data["segments"])
    key, value = rng.choice(
        (("mode", "other"), ("prompt", "Turn it"), ("conditioning", True), ("watch", {"retakes": 7}))
    )
    segment[key] = value
    return only_segment(segment["label"], {"prompt": "prompts"}.get(key, key))


def a_label(data: Any, rng: random.Random) -> Named:
    segment = rng.choice(data["segments"])
    before, after = segment["label"], f"{segment['label']}x"
    segment["label"] = after
    return lambda found: any(
        (item.before, item.after) == (before, after) or item.after == after for item in found.segments
    )


def a_segment_removed(data: Any, rng: random.Random) -> Named:
    label = data["segments"].pop(rng.randrange(len(data["segments"])))["label"]
    return lambda found: [(item.before, item.after) for item in found.segments] == [(label, None)]


def a_segment_added(data: Any, rng: random.Random) -> Named:
    place = rng.randrange(len(data["segments"]) + 1)
    made = {**rng.choice(data["segments"]), "label": "added"}
    data["segments"].insert(place, made)
    return lambda found: [(item.before, item.after) for item in found.segments] == [(None, "added")]


def a_segment_moved(data: Any, rng: random.Random) -> Named:
    segments = data["segments"]
    place = rng.randrange(len(segments))
    moved = segments.pop(place)
    there = rng.choice([k for k in range(len(segments) + 1) if k != place])
    segments.insert(there, moved)

    def named(found: MeaningDifference) -> bool:
        labels = {item.after for item in found.segments}
        # Two neighbours that change places: either of them has moved.
        return all(item.moved and not item.changes for item in found.segments) and (
            labels == {moved["label"]} or (abs(there - place) == 1 and len(labels) == 1)
        )

    return named


def a_limit(data: Any, rng: random.Random) -> Named:
    name = rng.choice(list(data.get("estimates", {"none": 0})))
    quantity = f"{name}.made_up"
    data.setdefault("limits", [])
    data["limits"] = [*data["limits"], {"quantity": quantity, "within": f"±{rng.randint(1, 99)} deg/h"}]
    return only_part("limits", quantity)


def an_estimate(data: Any, rng: random.Random) -> Named:
    name = rng.choice(list(data["estimates"]))
    spec = data["estimates"][name]
    spec["outliers"] = "keep" if spec.get("outliers", "exclude") != "keep" else "refuse"
    return only_part("estimates", name, "outliers")


def a_selection(data: Any, rng: random.Random) -> Named:
    name = rng.choice(list(data["estimates"]))
    spec = data["estimates"][name]
    label = rng.choice(data["segments"])["label"]
    spec["segments"] = [label]
    return only_part("estimates", name, "segments")


def another_part(data: Any, rng: random.Random) -> Named:
    key, value, place = rng.choice(
        (
            ("bench", "another_bench", ("bench",)),
            ("report", ["certificate.html"], ("report",)),
            ("record", {"made_up": "required"}, ("record",)),
            ("diagnosis", {"nominal": ["accel_bias"]}, ("diagnosis",)),
            ("mounting", {"u": {"angle": f"{rng.randint(1, 80)} deg ± 1 arcsec"}}, ("mounting",)),
        )
    )
    data[key] = value
    return only_part(*place)


MUTATIONS = (
    a_quantity,
    an_orientation,
    a_motion,
    a_word,
    a_label,
    a_segment_removed,
    a_segment_added,
    a_segment_moved,
    a_limit,
    an_estimate,
    a_selection,
    another_part,
)


@pytest.mark.slow
def test_every_mutant_is_named() -> None:
    rng = random.Random(37)
    originals: dict[int, Meaning] = {}
    made: dict[str, int] = {}
    while sum(made.values()) < MUTANTS:
        number = rng.randrange(len(bases()))
        if number not in originals:
            original = read(bases()[number], rng)
            assert original is not None
            originals[number] = original
        data = copied(bases()[number])
        mutate = rng.choice(MUTATIONS)
        named = mutate(data, rng)
        mutant = read(data, rng)
        if mutant is None or mutant.document() == originals[number].document():
            continue  # not sound, or the value that it had
        made[mutate.__name__] = made.get(mutate.__name__, 0) + 1
        found = difference(originals[number], mutant)
        assert not found.empty, (mutate.__name__, data)
        assert named(found), (mutate.__name__, found)
        assert mutant.digest() != originals[number].digest()
    assert len(bases()) >= 5 and set(made) == {mutate.__name__ for mutate in MUTATIONS}, made


@pytest.mark.slow
def test_every_spelling_means_the_same() -> None:
    """A third as many spellings as mutants; the digest is compared too, as it knows no tolerance."""
    rng = random.Random(38)
    originals: dict[int, Meaning] = {}
    for _ in range(MUTANTS // 3):
        number = rng.randrange(len(bases()))
        if number not in originals:
            plan, _log = parse_plan(used()[number][0], "plan")
            assert plan is not None
            originals[number] = meaning_of_plan(plan)
        other = read(bases()[number], rng)
        assert other is not None
        assert difference(originals[number], other).empty
        assert other.digest() == originals[number].digest()
