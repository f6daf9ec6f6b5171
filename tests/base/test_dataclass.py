"""Quickly made dataclasses behave as the standard library's do: every shape is made by both and used in the same way."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from planrunner.base.dataclass import dataclass as quick


def shapes(make: Callable[..., Any], **options: bool) -> dict[str, type]:
    """The same classes by one decorator."""

    @make(**options)
    class Plain:
        """Two values and a default."""

        a: int
        b: str = "b"
        c: tuple[int, ...] = ()

    @make(**options)
    class Made:
        a: int
        seen: list[int] = dataclasses.field(default_factory=list)
        note: str = dataclasses.field(default="", compare=False, repr=False)
        kept: dict[str, int] = dataclasses.field(default_factory=dict, init=False)
        fixed: int = dataclasses.field(default=3, init=False)
        shared: ClassVar[int] = 4

        @property
        def double(self) -> int:
            return 2 * self.a

    @make(**options)
    class Checked:
        a: int
        named: int = dataclasses.field(default=1, kw_only=True)

        def __post_init__(self) -> None:
            if self.a < 0:
                raise ValueError("below zero")

        def __repr__(self) -> str:
            return f"<{self.a}>"

    @make(**options)
    class Derived(Plain):
        d: int = 5

    @make(**options)
    class Again(Derived):
        """Two levels, a default that is changed, a name given alone, and work after the parents' own."""

        b: str = "again"
        named: int = dataclasses.field(default=1, kw_only=True)
        total: int = dataclasses.field(default=0, init=False, compare=False)

        def __post_init__(self) -> None:
            object.__setattr__(self, "total", self.d + self.named)

    @make(**options)
    class Empty:
        """Nothing."""

    @make(**options)
    class One:
        a: Any

    @make(**options)
    class Compared:
        a: Any
        b: int = 0

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Compared) and self.a == other.a

        def __hash__(self) -> int:
            return 7

    return {cls.__name__: cls for cls in (Plain, Made, Checked, Derived, Again, Empty, One, Compared)}


CALLS: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("Plain", (1,), {}),
    ("Plain", (1, "x", (3,)), {}),
    ("Plain", (), {"a": 2, "c": (1,)}),
    ("Plain", (), {}),
    ("Plain", (1, "x", (3,), 4), {}),
    ("Plain", (1,), {"z": 1}),
    ("Made", (1,), {}),
    ("Made", (1, [2]), {"note": "n"}),
    ("Made", (1,), {"kept": {}}),
    ("Made", (1, None), {}),
    ("Checked", (1,), {"named": 2}),
    ("Checked", (-1,), {}),
    ("Checked", (1, 2), {}),
    ("Derived", (1,), {"d": 2}),
    ("Derived", (1, "b", (), 7), {}),
    ("Again", (1,), {"named": 4}),
    ("Again", (1, "x", (2,), 3), {}),
    ("Again", (1, "x", (2,), 3, 4), {}),
    ("Again", (), {"a": 1, "total": 2}),
    ("Empty", (), {}),
    ("One", (float("nan"),), {}),
    ("One", ([1],), {}),
    ("Compared", (1,), {"b": 2}),
]
OPTIONS = [
    {},
    {"frozen": True},
    {"slots": True},
    {"frozen": True, "slots": True},
    {"frozen": True, "slots": True, "eq": False},
    {"frozen": True, "kw_only": True},
]


def result(work: Callable[[], Any]) -> Any:
    """What comes out, or the kind of error that does. Some versions of the library say TypeError where a frozen class has slots."""
    try:
        return work()
    except AttributeError:
        return TypeError
    except Exception as error:
        return type(error)


def signature(cls: type) -> list[tuple[str, object, object, bool]]:
    """Names, kinds and annotations of what makes one, and whether each may be left out."""
    given = inspect.signature(cls).parameters.values()
    return [(one.name, one.kind, one.annotation, one.default is inspect.Parameter.empty) for one in given]


def used(cls: type, arguments: tuple[Any, ...], names: dict[str, Any], options: dict[str, bool]) -> list[Any]:
    """All that can be done with a record, told without addresses."""
    record: Any = result(lambda: cls(*arguments, **names))
    if isinstance(record, type):
        return [record]
    twin = cls(*arguments, **names)

    def change(name: str) -> Callable[[], Any]:
        def set_it() -> Any:
            setattr(twin, name, 9)
            return getattr(twin, name)

        return set_it

    def delete() -> None:
        del twin.a

    class Below(cls):
        """Derived without a decorator."""

    below = Below(*arguments, **names)

    def add() -> Any:
        below.strange = 9
        return below.strange

    def matched() -> Any:
        kind: Any = cls
        match record:
            case kind(first):
                return first
        return "no match"

    # Of a frozen class with slots, the standard library's own refusal fails where what is set is no field.
    sound = not (options.get("frozen") and options.get("slots"))
    by_identity: object = object.__hash__
    shown = repr(record).replace(cls.__qualname__, cls.__name__)
    return [
        shown,
        record == twin,
        record == cls(*(7, *arguments[1:])) if arguments and "kw_only" not in options else None,
        record != 3,
        result(lambda: (hash(record), hash(twin))) if cls.__hash__ is not by_identity else None,
        record == below,
        below == record,
        result(lambda: record < twin),
        result(add) if sound else None,
        result(lambda: setattr(below, "a", 9)) if sound or "a" in cls.__dataclass_fields__ else None,  # type: ignore[attr-defined]
        repr(result(matched)),
        repr(result(lambda: record.__reduce_ex__(2)[2:])),
        [(item.name, item.init, item.compare, item.kw_only) for item in dataclasses.fields(record)],
        result(lambda: dataclasses.asdict(record)).__repr__(),
        repr(result(lambda: dataclasses.replace(record, a=8))).replace(cls.__qualname__, cls.__name__),
        repr(copy.deepcopy(record)).replace(cls.__qualname__, cls.__name__),
        result(change("a")),
        result(change("strange")),
        result(delete),
        cls.__match_args__,  # type: ignore[attr-defined]
        hasattr(record, "__dict__"),
        signature(cls),
        cls.__doc__ if cls.__doc__ and "(" not in cls.__doc__ else None,
        sorted(cls.__dict__.get("__slots__", ())),
        dataclasses.is_dataclass(cls),
        cls.__dataclass_params__.frozen,  # type: ignore[attr-defined]
    ]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("call", CALLS, ids=str)
def test_they_are_used_alike(call: tuple[str, tuple[Any, ...], dict[str, Any]], options: dict[str, bool]) -> None:
    name, arguments, names = call
    ours, theirs = shapes(quick, **options)[name], shapes(dataclasses.dataclass, **options)[name]
    assert used(ours, arguments, names, options) == used(theirs, arguments, names, options)


@quick(frozen=True, slots=True)
class Base:
    """At the top of a module, so that it can be pickled."""

    a: int
    b: list[int] = dataclasses.field(default_factory=list)


@dataclasses.dataclass(frozen=True, slots=True)
class Beyond(Base):
    """What somebody else derives by the standard library."""

    c: int = 0


@pytest.mark.parametrize("record", [Base(1, [2]), Beyond(1, [2], 3)], ids=["own", "derived elsewhere"])
def test_they_are_pickled_and_derived_from(record: Base) -> None:
    assert pickle.loads(pickle.dumps(record)) == record
    assert copy.copy(record) == record
    assert record != Base(1, [3])
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.a = 2  # type: ignore[misc]


def test_a_class_that_mixes_frozen_and_open_is_refused_as_ever() -> None:
    with pytest.raises(TypeError, match="frozen"):

        @quick
        class Open(Base):  # type: ignore[misc]
            d: int = 0
