"""Computes the difference in meaning between two plans or two benches, as data.

Segments are matched in three steps. First, they are matched by their labels. Second, the remaining segments are matched by their
content (renamed segments). Third, segments that still remain are matched by their position between matched neighbours, if their
contents differ little. Matched segments that are not part of the longest common order count as moved. The computing time is
proportional to the number of segments n, except for the longest increasing subsequence, which takes a time proportional to n·log n.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import Literal

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.plan.quantity import Quantity
from planrunner.review.meaning import Branch, Meaning, StatedValue, plain

KeyPath = tuple[str, ...]
"""The sequence of keys to a part of a meaning, for example `("estimates", "drift", "terms")`."""

Tendency = Literal["loosened", "tightened", "both", ""]
"""Effect of a change on a limit. `loosened`: more values pass. `tightened`: fewer values pass. `both`: some values pass that failed
before, and some fail that passed before. Empty if the change does not concern a limit."""


@dataclass(frozen=True, slots=True)
class PartChange:
    """One part of a plan or bench that differs.

    `before`, `after`: canonical content of the part in each file; None if the part is absent. `shown`: the part as each file writes
    it; empty if the part is absent. `gained`, `lost`: added and removed values, if the part is a list of values in both files.
    """

    place: KeyPath
    before: Json
    after: Json
    shown: tuple[str, str]
    gained: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    tendency: Tendency = ""


@dataclass(frozen=True, slots=True)
class SegmentChange:
    """One segment that differs. `before`, `after`: label of the segment in each plan; None if the plan lacks the segment.
    `positions`: position of the segment in each plan, counted from 1."""

    before: str | None
    after: str | None
    positions: tuple[int | None, int | None]
    moved: bool
    changes: tuple[PartChange, ...]

    @property
    def renamed(self) -> bool:
        return self.before is not None and self.after is not None and self.before != self.after


@dataclass(frozen=True, slots=True)
class MeaningDifference:
    """The difference between two plans or two benches.

    `parts`: all differences outside the segments and limits. `texts`: texts for readers that changed; such changes do not count as
    a difference. `rounded`: quantities in different units that agree to the written digits; such quantities do not count as a
    difference either.
    """

    kind: str
    segments: tuple[SegmentChange, ...] = ()
    parts: tuple[PartChange, ...] = ()
    limits: tuple[PartChange, ...] = ()
    bench: tuple[PartChange, ...] = ()
    texts: tuple[PartChange, ...] = ()
    rounded: tuple[PartChange, ...] = ()
    pairs: tuple[tuple[int | None, int | None], ...] = field(default=(), repr=False)
    """Indices of matched segments, in the order of the second plan. Each removed segment comes after the segment that it followed
    in the first plan."""

    @property
    def empty(self) -> bool:
        return not (self.segments or self.parts or self.limits or self.bench)


def difference(
    before: Meaning, after: Meaning, bench_before: Meaning | None = None, bench_after: Meaning | None = None
) -> MeaningDifference:
    """Compares two meanings of the same kind. `bench_before`, `bench_after`: the benches of two plans; if they are given, their
    differences are listed too."""
    rounded: list[PartChange] = []
    texts = tuple(
        PartChange(("texts", name), text, after.texts.get(name, ""), (text, after.texts.get(name, "")))
        for name, text in before.texts.items()
        if text != after.texts.get(name, "")
    )
    if before.kind == "bench":
        parts = tuple(_changes((), before.content, after.content, rounded))
        return MeaningDifference("bench", parts=parts, texts=texts, rounded=tuple(rounded))
    old, new = before.content, after.content
    a, b = _segments(old), _segments(new)
    pairs = matched(a, b)
    segments = tuple(_segment_changes(a, b, pairs, rounded))
    names = {_label(a[i]): _label(b[j]) for i, j in pairs if i is not None and j is not None}
    labels = [_label(item) for item in a], [_label(item) for item in b]
    shared = ("segments", "limits", "bench")
    parts = tuple(
        _changes(
            (),
            _renamed({name: part for name, part in old.items() if name not in shared}, names, labels[0]),
            _renamed({name: part for name, part in new.items() if name not in shared}, {}, labels[1]),
            rounded,
        )
    )
    bench: tuple[PartChange, ...] = ()
    if bench_before is not None and bench_after is not None:
        bench = tuple(_changes((), bench_before.content, bench_after.content, rounded))
    elif plain(old["bench"]) != plain(new["bench"]):
        bench = tuple(_changes(("bench",), old["bench"], new["bench"], rounded))
    limits = tuple(_limits(_list(old["limits"]), _list(new["limits"]), rounded))
    return MeaningDifference("plan", segments, parts, limits, bench, texts, tuple(rounded), tuple(pairs))


# -- segments --------------------------------------------------------------------------------------------------------

Segment_ = Mapping[str, Branch]


def _segments(content: Mapping[str, Branch]) -> list[dict[str, Branch]]:
    return [item for item in _list(content["segments"]) if isinstance(item, dict)]


def _list(branch: Branch) -> list[Branch]:
    return branch if isinstance(branch, list) else []


def _label(segment: Segment_) -> str:
    label = segment["label"]
    return label.content if isinstance(label, StatedValue) else ""


MOST_CHANGED = 2
"""Two segments with different labels count as one changed segment if at most this number of their keys differ."""

_NEAR = 20
"""Maximum number of unmatched segments with which a segment is compared."""


def matched(a: Sequence[Segment_], b: Sequence[Segment_]) -> list[tuple[int | None, int | None]]:
    """Matches the segments of two sequences; returns pairs of indices (in a, in b), in the order of b. The index of a missing
    partner is None. An unmatched segment of a is placed after the matched segment that precedes it in a."""
    there = {_label(item): j for j, item in enumerate(b)}
    partner = {i: there[_label(item)] for i, item in enumerate(a) if _label(item) in there}
    taken = set(partner.values())
    by_content: dict[str, deque[int]] = defaultdict(deque)
    for j, item in enumerate(b):
        if j not in taken:
            by_content[_content(item)].append(j)
    for i, item in enumerate(a):
        if i not in partner and by_content.get(_content(item)):
            partner[i] = by_content[_content(item)].popleft()
            taken.add(partner[i])
    _match_in_gaps(a, b, partner, taken)
    back = {j: i for i, j in partner.items()}
    after: dict[int | None, list[int]] = defaultdict(list)  # removed segments by their matched predecessor
    last: int | None = None
    for i in range(len(a)):
        if i in partner:
            last = partner[i]
        else:
            after[last].append(i)
    pairs: list[tuple[int | None, int | None]] = [(i, None) for i in after[None]]
    for j in range(len(b)):
        pairs.append((back.get(j), j))
        pairs += [(i, None) for i in after[j]]
    return pairs


def _content(segment: Segment_) -> str:
    return repr([(name, plain(part)) for name, part in segment.items() if name != "label"])


def _match_in_gaps(a: Sequence[Segment_], b: Sequence[Segment_], partner: dict[int, int], taken: set[int]) -> None:
    """Matches further segments if they lie between the same matched neighbours in the two plans and if few of their keys differ.
    The order of the segments is preserved."""
    before_b: dict[int, deque[int]] = defaultdict(deque)  # unmatched of b by their matched predecessor, -1 for none
    last = -1
    for j in range(len(b)):
        if j in taken:
            last = j
        else:
            before_b[last].append(j)
    last = -1
    for i in range(len(a)):
        if i in partner:
            last = partner[i] if partner[i] in taken else last
            continue
        waiting = before_b.get(last, deque())
        for place in range(min(len(waiting), _NEAR)):
            j = waiting[place]
            if _changed_keys(a[i], b[j]) <= MOST_CHANGED:
                partner[i] = j
                for _ in range(place + 1):  # those passed over cannot be matched any more without a change of order
                    waiting.popleft()
                break
    taken.update(partner.values())


def _changed_keys(a: Segment_, b: Segment_) -> int:
    return sum(plain(a[name]) != plain(b[name]) for name in a if name != "label")


def _segment_changes(
    a: Sequence[Segment_],
    b: Sequence[Segment_],
    pairs: Sequence[tuple[int | None, int | None]],
    rounded: list[PartChange],
) -> Iterator[SegmentChange]:
    moved = _moved([i for i, j in pairs if i is not None and j is not None])
    for i, j in pairs:
        if i is None and j is not None:
            yield SegmentChange(None, _label(b[j]), (None, j + 1), False, tuple(_stated(b[j], False)))
        elif j is None and i is not None:
            yield SegmentChange(_label(a[i]), None, (i + 1, None), False, tuple(_stated(a[i], True)))
        elif i is not None and j is not None:
            old, new = a[i], b[j]
            found = [
                change
                for name in old
                if name != "label" and old[name] != new[name]
                for change in _changes((name,), old[name], new[name], rounded)
            ]
            if found or i in moved or _label(old) != _label(new):
                yield SegmentChange(_label(old), _label(new), (i + 1, j + 1), i in moved, tuple(found))


def _stated(segment: Segment_, removed: bool) -> Iterator[PartChange]:
    """Yields a change for each key with a value in an added or removed segment."""
    for name, part in segment.items():
        text = in_words(part)
        if name != "label" and plain(part) not in (None, [], False) and text:
            content = plain(part)
            yield (
                PartChange((name,), content, None, (text, ""))
                if removed
                else PartChange((name,), None, content, ("", text))
            )


def _moved(order: Sequence[int]) -> set[int]:
    """Returns the members of a sequence that are not in its longest increasing subsequence (Fredman, Discrete Mathematics 11,
    1975)."""
    tails: list[int] = []
    places: list[int] = []
    previous: list[int] = []
    for place, value in enumerate(order):
        at = bisect_left(tails, value)
        if at == len(tails):
            tails.append(value)
            places.append(place)
        else:
            tails[at], places[at] = value, place
        previous.append(places[at - 1] if at else -1)
    kept = set()
    place = places[-1] if places else -1
    while place >= 0:
        kept.add(order[place])
        place = previous[place]
    return set(order) - kept


def _renamed(content: dict[str, Branch], names: Mapping[str, str], all_labels: Sequence[str]) -> dict[str, Branch]:
    """Returns the content of a plan after renamed segments have been replaced by their new names in the selections of estimates and
    of the diagnosis. A selection that names every segment is replaced by the general selection of all segments."""
    made = dict(content)
    estimates = content["estimates"]
    assert isinstance(estimates, dict)
    made["estimates"] = {name: _reselected(spec, names, all_labels) for name, spec in estimates.items()}
    made["diagnosis"] = _reselected(content["diagnosis"], names, all_labels)
    return made


_ALL = StatedValue({"all": True}, "all segments")


def _reselected(spec: Branch, names: Mapping[str, str], all_labels: Sequence[str]) -> Branch:
    assert isinstance(spec, dict)
    chosen = spec["segments"]
    if isinstance(chosen, dict):
        return {**spec, "segments": {**chosen, "within": _relabelled(chosen["within"], names, all_labels)}}
    return {**spec, "segments": _relabelled(chosen, names, all_labels)}


def _relabelled(chosen: Branch, names: Mapping[str, str], all_labels: Sequence[str]) -> Branch:
    labels = [item.content for item in _list(chosen) if isinstance(item, StatedValue)]
    if labels == list(all_labels):
        return _ALL
    new = [names.get(label, label) for label in labels]
    return [StatedValue(label, label) for label in sorted(new)]


# -- limits ----------------------------------------------------------------------------------------------------------


def _limits(a: Sequence[Branch], b: Sequence[Branch], rounded: list[PartChange]) -> Iterator[PartChange]:
    """Yields the changes of limits. Limits are matched by their quantity. Several limits on the same quantity are matched in their
    order."""
    old, new = _by_quantity(a), _by_quantity(b)
    for name in dict.fromkeys([*old, *new]):
        before, after = old.get(name, []), new.get(name, [])
        left = [limit for limit in before if limit not in after]
        right = [limit for limit in after if limit not in before]
        for k in range(max(len(left), len(right))):
            one = left[k] if k < len(left) else None
            other = right[k] if k < len(right) else None
            if one is not None and other is not None and not list(_changes((), one, other, rounded)):
                continue
            yield PartChange(
                ("limits", name),
                None if one is None else plain(one),
                None if other is None else plain(other),
                (_limit_in_words(one, other), _limit_in_words(other, one)),
                tendency=tendency(one, other),
            )


def _by_quantity(limits: Sequence[Branch]) -> dict[str, list[dict[str, Branch]]]:
    found: dict[str, list[dict[str, Branch]]] = {}
    for limit in limits:
        assert isinstance(limit, dict)
        name = limit["quantity"]
        assert isinstance(name, StatedValue)
        found.setdefault(name.content, []).append(limit)
    return found


def _limit_in_words(limit: dict[str, Branch] | None, other: dict[str, Branch] | None) -> str:
    """Describes the bounds of a limit in words. If the limit is compared with another limit, also describes their other
    differences."""
    if limit is None:
        return ""
    low, high = limit["at_least"], limit["at_most"]
    assert isinstance(low, StatedValue) and isinstance(high, StatedValue)
    if low.quantity is not None and high.quantity is not None and low.quantity.value == -high.quantity.value:
        bounds = f"±{high.shown}"
    else:
        bounds = " and ".join(
            f"{sign} {part.shown}" for sign, part in (("≥", low), ("≤", high)) if part.quantity is not None
        )
    names = ["rule"] if other is None else [name for name in _RULE if plain(limit[name]) != plain(other[name])]
    return ", ".join([bounds, *(f"{name.replace('_', ' ')} {in_words(limit[name]) or 'none'}" for name in names)])


_RULE = ("rule", "guard_band", "coverage", "prior")
"""Keys of a limit in addition to its bounds."""


def tendency(before: Mapping[str, Branch] | None, after: Mapping[str, Branch] | None) -> Tendency:
    """Determines whether a change of a limit tightens it, so that fewer values pass, or loosens it. An added limit counts as
    tightened, and a removed limit counts as loosened.

    Bounds, rule, guard band and coverage are compared. A limit with a guard band accepts fewer values than a limit without one. A
    wider guard band or a higher coverage also accepts fewer values (JCGM 106:2012, 8.3).
    """
    if before is None or after is None:
        return "tightened" if before is None else "loosened"
    signs = {
        _sign(_bound(before["at_least"], -math.inf), _bound(after["at_least"], -math.inf)),
        _sign(_bound(after["at_most"], math.inf), _bound(before["at_most"], math.inf)),
        _sign(plain(before["rule"]) == "guarded", plain(after["rule"]) == "guarded"),
    }
    if plain(after["rule"]) == "guarded" and plain(before["rule"]) == "guarded":
        signs.add(_sign(plain(before["guard_band"]), plain(after["guard_band"])))
        signs.add(_sign(plain(before["coverage"]), plain(after["coverage"])))
    if {1, -1} <= signs:
        return "both"
    return "tightened" if 1 in signs else "loosened" if -1 in signs else ""


def _sign(before: float, after: float) -> int:
    if before == after or math.isclose(before, after, rel_tol=1e-11):
        return 0
    return 1 if after > before else -1


def _bound(branch: Branch, absent: float) -> float:
    """Returns a bound of a limit in SI units."""
    if not isinstance(branch, StatedValue) or branch.quantity is None:
        return absent
    return branch.quantity.value


# -- any part --------------------------------------------------------------------------------------------------------


def _changes(place: KeyPath, a: Branch, b: Branch, rounded: list[PartChange]) -> Iterator[PartChange]:
    """Yields the parts in which two branches of a meaning differ. As long as the two branches have the same form, their parts are
    compared in turn."""
    if isinstance(a, StatedValue) and isinstance(b, StatedValue):
        if a.content == b.content:
            return
        change = PartChange(place, a.content, b.content, (a.shown, b.shown))
        if equal_to_rounding(a.quantity, b.quantity):
            rounded.append(change)
        else:
            yield change
    elif isinstance(a, dict) and isinstance(b, dict) and (not a or not b or a.keys() & b.keys()):
        for name in dict.fromkeys([*a, *b]):
            if name not in a or name not in b:
                part = b[name] if name not in a else a[name]
                text = in_words(part)
                shown = ("", text) if name not in a else (text, "")
                yield PartChange(
                    (*place, name),
                    None if name not in a else plain(part),
                    None if name not in b else plain(part),
                    shown,
                )
            else:
                yield from _changes((*place, name), a[name], b[name], rounded)
    elif isinstance(a, list) and isinstance(b, list):
        yield from _list_changes(place, a, b, rounded)
    elif plain(a) != plain(b):
        yield PartChange(place, plain(a), plain(b), (in_words(a), in_words(b)))


def _list_changes(place: KeyPath, a: list[Branch], b: list[Branch], rounded: list[PartChange]) -> Iterator[PartChange]:
    values = all(isinstance(item, StatedValue) for item in (*a, *b))
    if len(a) == len(b) and not (values and _texts(a) and _texts(b)):
        for index, (one, other) in enumerate(zip(a, b, strict=True), start=1):
            yield from _changes((*place, str(index)), one, other, rounded)
    elif plain(a) != plain(b):
        old, new = [in_words(item) for item in a], [in_words(item) for item in b]
        gained = tuple(text for text in dict.fromkeys(new) if text not in set(old))
        lost = tuple(text for text in dict.fromkeys(old) if text not in set(new))
        yield PartChange(place, plain(a), plain(b), (", ".join(old), ", ".join(new)), gained, lost)


def _texts(branches: Sequence[Branch]) -> bool:
    return all(isinstance(item, StatedValue) and isinstance(item.content, str) for item in branches)


LARGEST_ROUNDING = 1e-4
"""Largest relative difference that counts as rounding."""


def equal_to_rounding(a: Quantity | None, b: Quantity | None) -> bool:
    """Returns True if two quantities in different units are equal within half a unit of the last written digit of each.

    For example, 30 deg/s and 0.5236 rad/s are equal; 30 deg/s and 0.52 rad/s are not (0.7 %). In the same unit, every difference
    counts.
    """
    if a is None or b is None or a.unit.dimension != b.unit.dimension or a.unit.text == b.unit.text:
        return False
    if (a.standard_uncertainty, a.distribution) != (b.standard_uncertainty, b.distribution):
        return False
    apart = abs(a.value - b.value)
    return apart <= min(_half_digit(a), _half_digit(b), LARGEST_ROUNDING * max(abs(a.value), abs(b.value)))


def _half_digit(quantity: Quantity) -> float:
    """Returns half a unit of the last written digit of a quantity, in SI units."""
    mantissa, _, exponent = f"{quantity.unit.from_si(quantity.value):.9g}".partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    return float(0.5 * 10.0**-decimals * quantity.unit.factor)


def in_words(branch: Branch) -> str:
    """Returns the text of one part of a plan or bench (a branch of its `Meaning`), in one line. The text is empty if the part states
    nothing."""
    if isinstance(branch, StatedValue):
        return "" if branch.content is None else branch.shown
    if isinstance(branch, dict):
        return ", ".join(f"{name} {text}" for name, part in branch.items() if (text := in_words(part)))
    return ", ".join(in_words(part) for part in branch)
