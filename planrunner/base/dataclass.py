"""Provides the decorator `dataclass` of the standard library in a version that creates classes four times as fast.

Reading and checking a plan needs about 180 record classes. The standard library compiles six functions for each class; this took a
third of the time of `check`. This module compiles only `__init__`, and classes with the same form of `__init__` share one compiled
function. The methods for comparison, hashing and representation, and the methods that refuse changes, are closures over the field
names. In all other respects, such a class is like a class of the standard library: for readers, type checkers, `fields`, `replace`,
`asdict`, `copy` and `pickle`, there is no difference.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from inspect import get_annotations
from operator import attrgetter
from reprlib import recursive_repr
from types import CodeType, FunctionType, MemberDescriptorType
from typing import TYPE_CHECKING, Any

WRITTEN = ("__init__", "__eq__", "__hash__", "__setattr__", "__delattr__")
"""If a class defines one of these methods itself, the standard library makes the class, because the standard library adapts the
other methods to such a method."""
_SPECIAL = ("ClassVar", "InitVar", "KW_ONLY")
KNOWN = {"frozen", "slots", "eq", "kw_only"}


def _dataclass(given: type | None = None, /, **options: bool) -> Any:
    """Returns a decorator with the same effect as `dataclasses.dataclass`."""
    if given is None:
        return lambda cls: _dataclass(cls, **options)
    bases: list[Any] = [base for base in given.__mro__[1:] if "__dataclass_fields__" in base.__dict__]
    if (
        not options.keys() <= KNOWN
        or any(name in given.__dict__ for name in WRITTEN)
        or any("InitVar" in str(kind) for kind in get_annotations(given).values())
        or not all("__made_here__" in base.__dict__ for base in bases)
        or any(base.__dataclass_params__.frozen != options.get("frozen", False) for base in bases)
    ):
        return dataclasses.dataclass(given, **options)
    return _made(given, bases, **options)


def _made(
    given: type,
    bases: list[Any],
    *,
    frozen: bool = False,
    slots: bool = False,
    eq: bool = True,
    kw_only: bool = False,
) -> Any:
    undocumented = given.__doc__ is None
    if undocumented:  # else the standard library looks for a signature
        given.__doc__ = given.__name__
    with _thawed(bases), _untyped(given) as kinds:
        made: Any = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only)(given)
        for name in kinds:
            made.__dataclass_fields__[name].type = kinds[name]
        if kinds:
            made.__annotations__ = kinds
    found = dataclasses.fields(made)
    if undocumented:
        made.__doc__ = f"{given.__name__}({', '.join(item.name for item in found if item.init)})"
    made.__made_here__ = True
    _write(made, "__init__", _initialiser(made, found, frozen))
    if "__repr__" not in given.__dict__:
        _write(made, "__repr__", _shown([item.name for item in found if item.repr]))
    params = made.__dataclass_params__
    params.init, params.repr, params.eq = True, True, eq
    if eq:
        _write(made, "__eq__", _equal(_values([item.name for item in found if item.compare])))
        made.__hash__ = None
        if frozen:
            counted = [item.name for item in found if (item.compare if item.hash is None else item.hash)]
            _write(made, "__hash__", _hashed(_values(counted)))
    if frozen:
        params.frozen = True
        names = frozenset(item.name for item in found)
        _write(made, "__setattr__", _refuses_to_set(made, names))
        _write(made, "__delattr__", _refuses_to_delete(made, names))
        if slots:
            made.__getstate__, made.__setstate__ = _state, _with_state
    return made


@contextmanager
def _thawed(bases: list[Any]) -> Iterator[None]:
    """Marks the base classes as not frozen while the context is open. This module always lets the standard library make a class
    that is not frozen, and adds the methods of a frozen class afterwards. The standard library refuses such a class if a base class
    is marked as frozen."""
    frozen = [base.__dataclass_params__ for base in bases if base.__dataclass_params__.frozen]
    try:
        for params in frozen:
            params.frozen = False
        yield
    finally:
        for params in frozen:
            params.frozen = True


@contextmanager
def _untyped(given: type) -> Iterator[dict[str, object]]:
    """Temporarily removes the annotations of a class. This saves time, because the standard library searches each annotation three
    times for the words of the special annotations in `_SPECIAL`. If an annotation contains such a word, nothing is removed, so that
    the standard library finds it."""
    kinds = get_annotations(given)
    if any(word in kind for kind in map(str, kinds.values()) for word in _SPECIAL):
        yield {}
        return
    given.__annotations__ = dict.fromkeys(kinds, object)
    try:
        yield kinds
    finally:
        given.__annotations__ = kinds


def _write(made: Any, name: str, function: Any) -> None:
    function.__name__ = name
    function.__qualname__ = f"{made.__qualname__}.{name}"
    setattr(made, name, function)


def _initialiser(made: Any, found: tuple[dataclasses.Field[Any], ...], frozen: bool) -> Any:
    """Makes the method `__init__`, which is the only compiled method. The method is compiled once for all classes with the same
    form of `__init__`. Each class then receives a copy with the names of its fields."""
    names: dict[str, object] = {"absent": dataclasses.MISSING}
    slots = {
        item.name: own for item in found if isinstance(own := getattr(made, item.name, None), MemberDescriptorType)
    }
    plain: list[str] = []
    by_name: list[str] = []
    lines: list[str] = []
    defaults: list[object] = []
    defaults_by_name: dict[str, object] = {}
    for place, item in enumerate(found):
        own = value = f"_{place}"
        if item.default is not dataclasses.MISSING:
            if not item.init and item.name not in slots:
                continue  # the class has it
            if not item.init:
                names[value := f"default_{place}"] = item.default
        elif item.default_factory is not dataclasses.MISSING:
            names[f"make_{place}"] = item.default_factory
            value = f"make_{place}()" + (f" if {own} is absent else {own}" if item.init else "")
        elif not item.init:
            continue
        if item.init:
            (by_name if item.kw_only else plain).append(own)
            if not (item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING):
                if item.kw_only:
                    defaults_by_name[item.name] = item.default
                else:
                    defaults.append(item.default)
        if frozen and item.name in slots:
            names[f"set_{place}"] = slots[item.name].__set__
            lines.append(f"set_{place}(self, {value})")
        else:
            lines.append(f"put['{own}'] = {value}" if frozen else f"self.{own} = {value}")
    if any(line.startswith("put[") for line in lines):
        lines.insert(0, "put = self.__dict__")
    if hasattr(made, "__post_init__"):
        lines.append("self.__post_init__()")
    parameters = ", ".join(["self", *plain, *(["*", *by_name] if by_name else [])])
    code = _compiled(f"def __init__({parameters}):\n  " + "\n  ".join(lines or ["pass"]))
    named = {f"_{place}": item.name for place, item in enumerate(found)}
    code = code.replace(
        co_varnames=tuple(named.get(one, one) for one in code.co_varnames),
        co_names=tuple(named.get(one, one) for one in code.co_names),
        co_consts=tuple(named.get(one, one) if isinstance(one, str) else one for one in code.co_consts),
    )
    function: Any = FunctionType(code, names, "__init__", tuple(defaults))
    function.__kwdefaults__ = defaults_by_name or None
    function.__module__ = made.__module__
    function.__annotations__ = {item.name: item.type for item in found if item.init} | {"return": None}
    return function


@cache
def _compiled(source: str) -> CodeType:
    names: dict[str, FunctionType] = {}
    exec(source, names)
    return names["__init__"].__code__


def _values(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Returns a function that returns the values of the named attributes of a record, in the order of the names."""
    if not names:
        return lambda _: ()
    get: Any = attrgetter(*names)
    return get if len(names) > 1 else lambda record: (get(record),)


def _equal(values: Callable[[Any], tuple[Any, ...]]) -> Any:
    def equal(self: Any, other: Any) -> Any:
        if other.__class__ is self.__class__:
            return values(self) == values(other)
        return NotImplemented

    return equal


def _hashed(values: Callable[[Any], tuple[Any, ...]]) -> Any:
    def hashed(self: Any) -> int:
        return hash(values(self))

    return hashed


def _shown(names: list[str]) -> Any:
    @recursive_repr()
    def shown(self: Any) -> str:
        return f"{self.__class__.__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    return shown


def _refuses_to_set(made: Any, names: frozenset[str]) -> Any:
    def refuse(self: Any, name: str, value: object) -> None:
        if type(self) is made or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        super(made, self).__setattr__(name, value)

    return refuse


def _refuses_to_delete(made: Any, names: frozenset[str]) -> Any:
    def refuse(self: Any, name: str) -> None:
        if type(self) is made or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
        super(made, self).__delattr__(name)

    return refuse


def _state(self: Any) -> list[Any]:
    return [getattr(self, item.name) for item in dataclasses.fields(self)]


def _with_state(self: Any, state: list[Any]) -> None:
    for item, value in zip(dataclasses.fields(self), state, strict=True):
        object.__setattr__(self, item.name, value)


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:
    dataclass = _dataclass
