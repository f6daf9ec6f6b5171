"""Decodes the messages of ROS 1 and ROS 2: finds the numeric fields of a message type, and reads these fields from the bytes of a
message.

The package rosbags parses the definitions of the types, and knows the types that are part of ROS. Its own decoder executes Python
code that it generates from a definition. This module converts a definition to a list of decoding steps instead, so that no code
from a file is executed. Sources: Common Data Representation (OMG, DDS-XTypes 1.3, section 7.4.1, PLAIN_CDR) for ROS 2; the
serialization of ROS 1 (roscpp, `serialization.h`).

A field has the name that a program for ROS would use (`angular_velocity.x`). The elements of an array are counted from 1
(`orientation_covariance[9]`). A time or duration is one number in s.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

MessageBytes = bytes | memoryview

MAX_DEFINITION = 300_000
"""Maximum number of characters of a definition. The parser usually needs 2 s for a definition of this length; the slowest
definition that was tried needed 12 s."""
MAX_ELEMENTS = 64
"""Maximum length of an array whose elements are columns. Longer arrays are not read."""
MAX_FIELDS = 5_000
"""Maximum number of fields of a type, including the fields of the types that it contains."""
MAX_DEPTH = 16
"""Maximum nesting depth of types."""
_TIMES = {"builtin_interfaces/msg/Time": ["I", "I"], "builtin_interfaces/msg/Duration": ["i", "i"]}
"""Codes of the seconds and nanoseconds in the types for times and durations of ROS 1."""
_TIMES_2 = {"builtin_interfaces/msg/Time": ["i", "I"], "builtin_interfaces/msg/Duration": ["i", "I"]}
"""The same codes for ROS 2."""
_CODES = {
    "bool": "B",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Codes of the module struct. In ROS 1, `byte` is a signed number."""
_UNITS = {
    ("sensor_msgs/msg/Imu", "angular_velocity"): "rad/s",
    ("sensor_msgs/msg/Imu", "linear_acceleration"): "m/s^2",
    ("geometry_msgs/msg/Twist", "angular"): "rad/s",
    ("geometry_msgs/msg/Accel", "linear"): "m/s^2",
    ("sensor_msgs/msg/MagneticField", "magnetic_field"): "T",
    ("sensor_msgs/msg/Temperature", "temperature"): "degC",
    ("sensor_msgs/msg/FluidPressure", "fluid_pressure"): "Pa",
}
"""Units of fields, as the definitions of the types state them (REP 103)."""


@dataclass(frozen=True, slots=True)
class FieldType:
    """The type of a field. `name`: `string`, a type of numbers such as `float64`, or the name of another type. `is_message`: True if
    it is another type. `is_array`: True if the field contains several elements of this type. `count`: number of elements of an
    array; None for a list of any length."""

    name: str
    is_message: bool
    is_array: bool = False
    count: int | None = None

    @property
    def element(self) -> FieldType:
        """Returns the type of an element of an array."""
        return FieldType(self.name, self.is_message)


Definitions = Mapping[str, Sequence[tuple[str, FieldType]]]
"""For each type, the names and the types of its fields."""


class UnreadableTypeError(Exception):
    """Reports why the messages of a type cannot be read. `str()` continues a sentence whose subject is the type."""


class WrongMessageError(Exception):
    """Reports why a message cannot be decoded. `str()` is a sentence about the message."""


@dataclass(frozen=True, slots=True)
class MessageType:
    """A type of messages. `name`: its name in the form of ROS 2, such as `sensor_msgs/msg/Imu`. `definitions`: the fields of this
    type, and of the types that it contains. `is_cdr`: True for the serialization of ROS 2."""

    name: str
    definitions: Definitions
    is_cdr: bool

    def fields(self) -> dict[str, str]:
        """Returns the names of the numeric fields, each with its unit; the unit is empty if the definition does not state one.
        Raises `UnreadableTypeError` if the messages cannot be decoded."""
        return _Layout.of(self, "<", None).columns


def message_type(name: str, text: str, *, is_cdr: bool) -> MessageType:
    """Finds the definition of a type. `text`: its definition and the definitions of the types that it contains, as a bag stores
    them; empty if the bag stores none. Without a definition, the type must be part of ROS 2. Raises `UnreadableTypeError` if there
    is no definition, or if it cannot be parsed. Raises `ImportError` if the package rosbags is absent."""
    from rosbags.typesys import TypesysError, get_types_from_msg

    usual = usual_name(name)
    if not text:
        if usual not in _types_of_ros():
            raise UnreadableTypeError("is not part of ROS, and the bag does not contain its definition")
        return MessageType(usual, _types_of_ros(), is_cdr)
    if len(text) > MAX_DEFINITION:
        raise UnreadableTypeError(f"has a definition of more than {MAX_DEFINITION} characters")
    try:
        parsed = get_types_from_msg(text.replace("\r\n", "\n"), name)
    except (TypesysError, RecursionError, AssertionError, ValueError, OverflowError):
        raise UnreadableTypeError("has a definition that is not in the form of a .msg file of ROS") from None
    return MessageType(usual, _fields_of(parsed), is_cdr)


def usual_name(name: str) -> str:
    """Returns the name of a type in the form of ROS 2: `sensor_msgs/msg/Imu` for `sensor_msgs/Imu`."""
    package, _, own = name.rpartition("/")
    return name if package.endswith(("/msg", "/action")) or not package else f"{package}/msg/{own}"


@functools.cache
def _types_of_ros() -> Definitions:
    """Returns the types that are part of ROS 2 Humble, the last version whose bags may lack definitions."""
    from rosbags.typesys import Stores, get_typestore

    return _fields_of(get_typestore(Stores.ROS2_HUMBLE).fielddefs)


def _fields_of(types: Typesdict) -> Definitions:
    """Returns the fields of types that rosbags has parsed."""
    return {kind: [(name, _field_type(desc)) for name, desc in fields] for kind, (_, fields) in types.items()}


def _field_type(desc: FieldDesc) -> FieldType:
    from rosbags.interfaces import Nodetype

    if desc[0] == Nodetype.BASE:
        return FieldType(desc[1][0], is_message=False)
    if desc[0] == Nodetype.NAME:
        return FieldType(desc[1], is_message=True)
    element, count = desc[1]
    inner = _field_type(element)
    return replace(inner, is_array=True, count=count if desc[0] == Nodetype.ARRAY else None)


class MessageReader:
    """Reads some fields of the messages of a type. Raises `UnreadableTypeError` if the messages cannot be decoded. `columns`: the
    names of the fields."""

    def __init__(self, of_type: MessageType, columns: Sequence[str]):
        self._is_cdr, self._columns = of_type.is_cdr, columns
        wanted = frozenset(columns)
        self._layouts = {1: _Layout.of(of_type, "<", wanted)}
        if self._is_cdr:
            self._layouts[0] = _Layout.of(of_type, ">", wanted)

    def numbers(self, message: MessageBytes) -> list[float]:
        """Returns the numbers in a message that the selected fields consist of. Raises `WrongMessageError` if the bytes are not a
        message of this type."""
        layout, body = self._layouts[1], message
        if self._is_cdr:
            if len(message) < 4 or message[0] != 0 or message[1] not in (0, 1):
                raise WrongMessageError(
                    f"it does not begin as a message in CDR: {bytes(message[:4]).hex(' ') or 'empty'}"
                )
            layout, body = self._layouts[message[1]], message[4:]
        values: list[float] = []
        position = 0
        try:
            for step in layout.steps:
                position = step.read(body, position, values)
        except struct.error:
            raise WrongMessageError(f"it has {len(message)} bytes, fewer than its type needs") from None
        if not 0 <= len(body) - position <= (3 if self._is_cdr else 0):  # CDR may be filled up to a multiple of 4 bytes
            raise WrongMessageError(f"it has {len(message)} bytes, which do not fit its type")
        return values

    def values(self, rows: Sequence[Sequence[float]]) -> dict[str, Array]:
        """Returns the values (n,) of each field, from the numbers of n messages."""
        parts = self._layouts[1].parts
        table = np.array(rows, np.float64).reshape(len(rows), len(parts))
        found: dict[str, Array] = {}
        for index, (column, scale) in enumerate(parts):
            found[column] = found[column] + scale * table[:, index] if column in found else table[:, index]
        return {column: found[column] for column in self._columns}


class _Step(Protocol):
    """A step of decoding."""

    least: int
    """Smallest number of bytes that the step decodes or skips."""

    def read(self, body: MessageBytes, position: int, values: list[float]) -> int:
        """Adds the numbers that are wanted to `values`, and returns the position of the next step. Raises `struct.error` or
        `WrongMessageError` if the bytes do not match the step."""


class _Block:
    """A block of numbers at known offsets. `align`: the block begins at a multiple of this number of bytes."""

    def __init__(self, form: str, align: int):
        made = struct.Struct(form)
        self._unpack, self._size, self._align, self.least = made.unpack_from, made.size, align, made.size

    def read(self, body: MessageBytes, position: int, values: list[float]) -> int:
        position = position + self._align - 1 & -self._align
        values += self._unpack(body, position)
        return position + self._size


class _Sequence:
    """Skips a text, or a list of numbers of any length. `size`: number of bytes of an element."""

    def __init__(self, order: str, size: int, *, is_cdr: bool):
        self._unpack, self._size, self.least = struct.Struct(f"{order}I").unpack_from, size, 4
        self._align = 4 if is_cdr else 1
        self._inner = size if is_cdr else 1

    def read(self, body: MessageBytes, position: int, values: list[float]) -> int:
        position = position + self._align - 1 & -self._align
        (count,) = self._unpack(body, position)
        position += 4
        if count:
            position = (position + self._inner - 1 & -self._inner) + count * self._size
        if position > len(body):
            raise WrongMessageError(
                f"it contains a text or a list of {count} elements, which is longer than the message"
            )
        return position


class _Repeated:
    """Skips elements of a type with several fields. `count`: number of elements; None if the message states this number."""

    def __init__(self, order: str, count: int | None, steps: Sequence[_Step], *, is_cdr: bool):
        self._unpack, self._count, self._steps = struct.Struct(f"{order}I").unpack_from, count, steps
        self._align = 4 if is_cdr else 1
        self._element = sum(step.least for step in steps)
        self.least = 4 if count is None else count * self._element

    def read(self, body: MessageBytes, position: int, values: list[float]) -> int:
        count = self._count
        if count is None:
            position = position + self._align - 1 & -self._align
            (count,) = self._unpack(body, position)
            position += 4
        if count * self._element > len(body) - position:
            raise WrongMessageError(f"it contains a list of {count} elements, which is longer than the message")
        if self._element:
            for _ in range(count):
                for step in self._steps:
                    position = step.read(body, position, values)
        return position


class _Layout:
    """The steps that decode the messages of a type.

    `columns`: all numeric fields, with their units. `parts`: for each number that the steps read, its field and the factor that
    converts the number to the unit of the field. A time consists of two numbers. `_modulus`, `_offset`: the current position is
    `_offset` plus a multiple of `_modulus` bytes. `count`: number of fields so far, shared with the layouts of elements."""

    def __init__(
        self, of_type: MessageType, order: str, wanted: Collection[str] | None, modulus: int, count: list[int]
    ):
        self.type, self.order, self.wanted, self._count = of_type, order, wanted, count
        self.steps: list[_Step] = []
        self.columns: dict[str, str] = {}
        self.parts: list[tuple[str, float]] = []
        self._modulus, self._offset = modulus, 0
        self._form, self._align = "", 1

    @classmethod
    def of(cls, of_type: MessageType, order: str, wanted: Collection[str] | None) -> _Layout:
        """Makes the layout of a whole message. `order`: `<` if the least significant byte comes first, otherwise `>`. `wanted`: the
        fields that are read; None for all."""
        made = cls(of_type, order, wanted, 8, [0])
        made._message(of_type.name, "", "", 0)
        made._close()
        return made

    def _message(self, name: str, prefix: str | None, unit: str, depth: int) -> None:
        """Adds the fields of a type. `prefix`: start of the names of the fields; None if the fields are skipped."""
        if depth > MAX_DEPTH:
            raise UnreadableTypeError(f"contains types in types, more than {MAX_DEPTH} deep")
        times = (_TIMES_2 if self.type.is_cdr else _TIMES).get(name)
        if times is not None:
            column = None if prefix is None else prefix.removesuffix(".")
            for code, scale in zip(times, (1.0, 1e-9), strict=True):
                self._number(code, column, "s", scale)
            return
        if name not in self.type.definitions:
            raise UnreadableTypeError(f"contains the type {name}, whose definition is not in the bag")
        fields = self.type.definitions[name]
        if not fields and self.type.is_cdr:
            self._number("B", None, "", 1.0)  # in ROS 2, a type without fields occupies one byte
        for field, kind in fields:
            one = None if prefix is None or field == "structure_needs_at_least_one_member" else prefix + field
            self._field(kind, one, _UNITS.get((name, field), unit), depth)

    def _field(self, kind: FieldType, name: str | None, unit: str, depth: int) -> None:
        self._count[0] += 1
        if self._count[0] > MAX_FIELDS:
            raise UnreadableTypeError(f"has more than {MAX_FIELDS} fields")
        if kind.is_array:
            self._elements(kind, name, unit, depth)
        elif kind.is_message:
            self._message(kind.name, None if name is None else f"{name}.", unit, depth + 1)
        elif kind.name == "string":
            self._add(_Sequence(self.order, 1, is_cdr=self.type.is_cdr))
        else:
            self._number(self._code(kind.name), name, unit, 1.0)

    def _code(self, kind: str) -> str:
        if kind not in _CODES:
            raise UnreadableTypeError(f"contains fields of the type {kind}, which planrunner does not read")
        return "b" if kind == "byte" and not self.type.is_cdr else _CODES[kind]

    def _elements(self, kind: FieldType, name: str | None, unit: str, depth: int) -> None:
        """Adds an array, or a list of any length."""
        element, count = kind.element, kind.count
        plain = not kind.is_message and kind.name != "string"
        if count is not None and count <= MAX_ELEMENTS and name is not None:
            for number in range(1, count + 1):
                self._field(element, f"{name}[{number}]", unit, depth)
        elif plain and count is None:
            self._add(_Sequence(self.order, struct.calcsize(f"={self._code(kind.name)}"), is_cdr=self.type.is_cdr))
        elif plain and count:
            self._numbers(self._code(kind.name), count)
        elif count != 0:
            inner = _Layout(self.type, self.order, (), 1, self._count)
            inner._field(element, None, "", depth + 1)
            inner._close()
            self._add(_Repeated(self.order, count, inner.steps, is_cdr=self.type.is_cdr))

    def _number(self, code: str, column: str | None, unit: str, scale: float) -> None:
        self._aligned(struct.calcsize(f"={code}"))
        if column is not None:
            self.columns[column] = unit
        if column is not None and (self.wanted is None or column in self.wanted):
            self._form += code
            self.parts.append((column, scale))
        else:
            self._form += f"{struct.calcsize(f'={code}')}x"
        self._offset += struct.calcsize(f"={code}")

    def _numbers(self, code: str, count: int) -> None:
        """Adds an array of numbers that is skipped."""
        size = struct.calcsize(f"={code}")
        self._aligned(size)
        self._form += f"{count * size}x"
        self._offset += count * size

    def _aligned(self, size: int) -> None:
        """Moves to a multiple of the size of a number. The numbers of ROS 1 are not aligned."""
        if not self.type.is_cdr:
            return
        if self._modulus < size:
            self._close()
            self._align, self._modulus, self._offset = size, size, 0
        filled = -self._offset % size
        if filled:
            self._form += f"{filled}x"
            self._offset += filled

    def _add(self, step: _Step) -> None:
        """Adds a step after which the position is unknown."""
        self._close()
        self.steps.append(step)
        self._modulus, self._offset = 1, 0

    def _close(self) -> None:
        """Completes the current block of numbers."""
        if self._form:
            try:
                self.steps.append(_Block(self.order + self._form, self._align))
            except (struct.error, OverflowError):
                raise UnreadableTypeError("contains an array that is longer than any message") from None
        self._form, self._align = "", 1
