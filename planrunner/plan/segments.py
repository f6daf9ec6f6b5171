"""Declares the plan keys for segments: states to reach and hold, sweeps over states, and steps that share a state.

A state consists of the orientation, the motion, the temperature, the readings that must settle before the segment records, and the
readings that must stay within limits while it records.

The key `for_each` declares sweeps over states. Several swept keys give all combinations of their values, in which the first key
changes slowest.

for_each: {rate: "±300, ±150 deg/s"}                    + then − for each
for_each: {temperature: [-40 degC, 20 degC]}
for_each: {orientation: {P1: {x: up, y: north}, …}}     names become labels

A label depends only on its value, never on the other values, so that adding, removing or splitting values renames no segment.
References to labels, tables of recordings, and plans that a design has written therefore stay valid. For this reason, signs follow
one rule:

- a rate always has its sign, because the sign is the sense of rotation (`R+10`, `R-10`);
- any other quantity has a sign only below zero, as engineers usually write it (`20degC`, `-40degC`);
- zero has no sign (`R0`).

Alternatively, labels could have signs only in sweeps that contain both signs. This alternative was rejected because it would rename
segments: `20degC` would be renamed when -40 degC is added, and `R+10` would become `R10` when a design splits a sweep into one
sweep for each rate.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Mapping
from dataclasses import field, replace

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.plan import source
from planrunner.plan.directions import DIRECTIONS
from planrunner.plan.kinds import (
    CHANNEL,
    Boolean,
    ByShape,
    Choice,
    Kind,
    ListOf,
    MapOf,
    Number,
    QuantityOf,
    Record,
    RecordOf,
    Schema,
    Sign,
    Text,
    WordOr,
    has_sign,
    key,
    keys_of,
    optional,
)
from planrunner.plan.orientation import Orientation, OrientationKind
from planrunner.plan.quantity import (
    Quantity,
    QuantityError,
    anchored,
    is_signed,
    parse_signed,
    parse_sweep,
    refuse_uncertainty,
    signed_schema,
    sweep_schema,
    uncertain_piece,
)

READINGS = ("position_error", "rate_error", "temperature_error", "temperature_drift")


class Tolerated(Record):
    """Declares the largest permitted magnitudes of the instruments' readings."""

    position_error: Quantity | None = optional(
        QuantityOf("angle", "positive"), "Following error of the table, on every axis.", "5 arcsec"
    )
    rate_error: Quantity | None = optional(
        QuantityOf("angular rate", "positive"), "Measured minus commanded rate, on every axis.", "0.002 deg/s"
    )
    temperature_error: Quantity | None = optional(
        QuantityOf("temperature", "positive"), "Measured minus commanded temperature of the chamber.", "0.5 K"
    )
    temperature_drift: Quantity | None = optional(
        QuantityOf("temperature rate", "positive"),
        "Rate at which the temperatures of the chamber and of the sensor change.",
        "0.1 K/min",
    )

    def stated(self) -> dict[str, Quantity]:
        """Returns the stated limits as a mapping from each reading to its largest permitted value."""
        return {name: getattr(self, name) for name in READINGS if getattr(self, name) is not None}


class StabilitySpec(Tolerated):
    """Declares a wait until the readings have settled: each stays within its limit for the time `for`, without interruption."""

    for_: Quantity = key(
        QuantityOf("time", "positive"),
        "Time for which the readings must stay within their limits.",
        "30 s",
        name="for",
    )
    within: Quantity = key(
        QuantityOf("time", "positive"), "The run stops if the readings have not settled after this time.", "10 min"
    )


class WatchSpec(Tolerated):
    """Limits on the readings while the segment records, and what happens when a limit is exceeded."""

    lost_frames: Quantity | None = optional(
        QuantityOf("ratio", "not negative"), "Share of the sensor's frames that may be missing.", "0.1 %"
    )
    corrupt_frames: Quantity | None = optional(
        QuantityOf("ratio", "not negative"), "Share of the sensor's frames that may have a wrong checksum.", "0 %"
    )
    doubts: str = key(
        Choice(("limit", "note")),
        "Treatment of samples that the instrument marks as doubtful (status bits). `limit`: they count as an exceeded limit; "
        "`note`: they are only reported in the journal.",
        "note",
        default="limit",
    )
    retakes: int = key(
        Number(0, 10, integer=True),
        "How many times a segment is recorded again if it exceeds a limit. If a limit is still exceeded after these retakes, "
        "the run stops. The data of each rejected attempt are kept, with the reason.",
        2,
        default=0,
    )


def _check_difference(record: Tolerated, log: Findings) -> None:
    stated = record.temperature_error
    if stated is not None and stated.unit.offset:
        hint = f"write {stated.unit.from_si(stated.value):g} K"
        log.error("meaning-range", record.at("temperature_error"), f"{stated} is a temperature, not a difference", hint)


def _check_stability(stability: StabilitySpec, log: Findings) -> None:
    _check_difference(stability, log)
    if not stability.stated():
        hint = "add for example `temperature_drift: 0.1 K/min`, or write a time alone"
        log.error("meaning-stability", stability.origin.mark, "this key names no reading that must settle", hint)
    if stability.within.value < stability.for_.value:
        message = f"{stability.within} is shorter than the {stability.for_} for which the readings must stay within their limits"
        log.error("meaning-stability", stability.at("within"), message, "make `within` longer")


STABILITY = RecordOf(StabilitySpec, _check_stability)
WATCH = RecordOf(WatchSpec, _check_difference)


RATE_UNCERTAINTY = (
    "`rate_uncertainty` of a scale-factor estimate, or as `rate_stability` of the table in the bench file"
)
"""The places at which the uncertainty of a rate can be stated, for messages."""


class RockSpec(Record):
    """Sinusoidal rocking of the table's rings."""

    amplitude: Quantity = key(QuantityOf("angle", "positive"), "Amplitude of each ring.", "3 deg")
    frequency: Quantity = key(QuantityOf("frequency", "positive"), "Frequency of all rings.", "0.2 Hz")
    phases: tuple[Quantity, ...] = key(
        ListOf(QuantityOf("angle"), single=True, minimum=1),
        "Phase of each ring, outermost first.",
        ["0 deg", "45 deg", "90 deg"],
        default_factory=tuple,
    )


class RecordedSpec(Record):
    """Channels of the recording that show a motion that was not commanded, for example of a hand-held sensor or a vehicle.

    One of angle, attitude and rates gives the rotation."""

    angle: str | None = optional(
        CHANNEL,
        "Encoder of the axis about which the sensor turns. It must read zero in the orientation of the segment.",
        "table_angle",
    )
    attitude: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=4, maximum=4),
        "Unit quaternion that converts vectors from the sensor's axes to East-North-Up, real part first.",
        ["q_w", "q_x", "q_y", "q_z"],
        default_factory=tuple,
    )
    rates: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=3, maximum=3),
        "Gyros of a reference, or of the sensor itself, that show the rotation about the sensor's x, y and z axes.",
        ["reference_gyro_x", "reference_gyro_y", "reference_gyro_z"],
        default_factory=tuple,
    )
    forces: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=3, maximum=3),
        "Accelerometers that show the specific force along the sensor's x, y and z axes. Without this key, the "
        "specific force is computed from gravity and the attitude.",
        ["reference_accel_x", "reference_accel_y", "reference_accel_z"],
        default_factory=tuple,
    )
    averaging: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Time over which outputs and motion are averaged before they are compared. By default, ten samples are averaged for an angle or "
        "an attitude, because their differences are noisy; rates are not averaged.",
        "50 ms",
    )


POSITION = r"[^ \x00-\x1f]{1,20}"
_TURN = r"[-+−]?(?:[0-9]{1,6}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})"
MOVE = rf" *(?P<start>{POSITION}) +(?P<turn>{_TURN}) *(?:deg|°)? +(?P<end>{POSITION}) *"


class MotionSpec(Record):
    """Declares the motion while the sensor records: one of rate, rock, cycle and recorded. Without these keys, the sensor is at rest."""

    rate: Quantity | None = optional(
        QuantityOf("angular rate", elsewhere=RATE_UNCERTAINTY), "Constant rate about the rotation axis.", "300 deg/s"
    )
    about: str = key(
        Choice(tuple(DIRECTIONS)),
        "Direction at the site about which the table spins.",
        "up",
        default="up",
    )
    recorded: RecordedSpec | None = optional(
        RecordOf(RecordedSpec),
        "A motion that was not commanded, such as that of a hand or a vehicle; the recording shows it.",
        {"rates": ["reference_gyro_x", "reference_gyro_y", "reference_gyro_z"]},
    )
    rock: RockSpec | None = optional(
        RecordOf(RockSpec), "Sinusoidal rocking.", {"amplitude": "3 deg", "frequency": "0.2 Hz"}
    )
    for_: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Rock at full amplitude for this part of the dwell only, then rest.",
        "8 min",
        name="for",
    )
    after: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Rest for this part of the dwell, then begin to rock; by default the rocking begins one period before the "
        "dwell.",
        "60 s",
    )
    cycle: dict[str, Quantity] | None = optional(
        MapOf(QuantityOf("angle"), pattern=POSITION),
        "Named positions of an indexing cycle.",
        {"A": "0 deg", "B": "90 deg", "C": "180 deg", "D": "270 deg"},
    )
    moves: tuple[str, ...] = key(
        ListOf(
            Text(
                MOVE,
                "a move such as 'A +180 C'",
                "write the first position, the turn in degrees, and the last position",
            ),
            minimum=1,
        ),
        "Moves of one cycle in order: from, turn in degrees, to.",
        ["A +180 C", "C -180 A"],
        default_factory=tuple,
    )
    turn_rate: Quantity | None = optional(
        QuantityOf("angular rate", "positive"), "Rate of the turns between stops.", "10 deg/s"
    )
    stop: Quantity | None = optional(
        QuantityOf("time", "not negative"), "Time at each stop; `0 s` for turns without stops.", "3 min"
    )
    sense: str = key(
        Choice(("counterclockwise", "clockwise")),
        "Sense of positive angles, as seen by an observer towards whom the rotation axis points.",
        "clockwise",
        default="counterclockwise",
    )


class Turns(Record):
    """Declares a dwell that is counted in whole turns of a spinning table, or in whole cycles of turns and stops."""

    turns: int | None = optional(Number(1, 1_000_000, integer=True), "Record for this many whole turns.", 1)
    cycles: int | None = optional(Number(1, 1_000_000, integer=True), "Record for this many whole cycles.", 34)
    at_least: Quantity | None = optional(
        QuantityOf("time", "positive"), "Add whole turns or cycles until the dwell lasts at least this long.", "30 s"
    )


TEMPERATURE_UNCERTAINTY = "`temperature_uncertainty` of the chamber in the bench file"
"""The places at which the uncertainty of a segment's temperature can be stated, for messages."""

NAME = r"[A-Za-z][A-Za-z0-9_-]{0,39}"


class Ramp(Record):
    """A temperature that changes while the segment records."""

    ramp_to: Quantity = key(
        QuantityOf("temperature", elsewhere=TEMPERATURE_UNCERTAINTY),
        "Temperature that the chamber is set to when recording begins.",
        "60 degC",
    )


@dataclass(frozen=True, slots=True)
class StateTraits:
    """Properties of a key of a state in addition to its value.

    `swept`: True if the key may be swept with `for_each`. `directed`: True if the sign of the quantity is a direction, so that
    labels show + as well as −. `decisive`: True if the rest of the segment cannot be checked when the value of this key could not
    be read. `replaces`: another key that states the same property in another form. A segment has only one of the two keys: setting
    this key removes an inherited value of the other key. `sweep_example`: an example of a sweep; it is given if the example of one
    value does not show how to write a sweep.
    """

    swept: bool = False
    directed: bool = False
    decisive: bool = False
    replaces: str | None = None
    sweep_example: object = None


class State(Record):
    """A state to reach and hold. Nested steps inherit the keys that they do not set.

    To add a key, declare it here with its traits. The schema, reading, inheritance, sweeps, labels and the reference of keys follow
    from this declaration. The schedule defines what the bench does for a key.
    """

    orientation: Orientation | None = optional(
        OrientationKind(),
        "Where the sensor's axes point, in words or as a rotation; 'unknown' for hand-held recordings.",
        {"x": "up", "y": "north", "z": "west"},
        traits=StateTraits(
            swept=True,
            decisive=True,
            sweep_example={
                "P1": {"x": "up", "y": "north", "z": "west"},
                "P2": {"x": "down", "y": "north", "z": "east"},
            },
        ),
    )
    rate: Quantity | None = optional(
        QuantityOf("angular rate", elsewhere=RATE_UNCERTAINTY),
        "Constant rate about the up direction. It has the same meaning as motion: {rate: …}.",
        "10 deg/s",
        traits=StateTraits(
            swept=True, directed=True, decisive=True, replaces="motion", sweep_example="±300, ±150 deg/s"
        ),
    )
    motion: MotionSpec | str | None = optional(
        WordOr(("rest",), RecordOf(MotionSpec)),
        "What the table does while the segment records; if this key is left out, the table is at rest.",
        {"rate": "10 deg/s"},
        traits=StateTraits(swept=True, decisive=True, replaces="rate"),
    )
    temperature: Quantity | Ramp | None = optional(
        ByShape(
            QuantityOf("temperature", elsewhere=TEMPERATURE_UNCERTAINTY),
            RecordOf(Ramp),
            what="a temperature or {ramp_to: …}",
        ),
        "Chamber temperature to hold, or a ramp during which the segment records.",
        "25 degC",
        traits=StateTraits(swept=True, decisive=True, sweep_example="-40, 20, 60 degC"),
    )
    supply_voltage: Quantity | None = optional(
        QuantityOf("voltage", "positive"),
        "Voltage that supplies the sensor. A person sets it, not a driver: ask for it with `prompt`. Virtual sensors respond to it.",
        "5 V",
        traits=StateTraits(swept=True, decisive=True, sweep_example="4.5, 5, 5.5 V"),
    )
    ambient_pressure: Quantity | None = optional(
        QuantityOf("pressure", "positive"),
        "Absolute pressure of the air around the sensor. A person sets it, not a driver: ask for it with "
        "`prompt`. Virtual sensors respond to it.",
        "900 hPa",
        traits=StateTraits(swept=True, decisive=True, sweep_example="200, 600, 1000 hPa"),
    )
    soak: Quantity | StabilitySpec | None = optional(
        ByShape(QuantityOf("time", "not negative"), STABILITY, what="a time or {for: …}"),
        "Wait after a new temperature is reached: for a time, or until readings have settled.",
        "60 min",
        traits=StateTraits(swept=True),
    )
    settle: Quantity | StabilitySpec | None = optional(
        ByShape(QuantityOf("time", "not negative"), STABILITY, what="a time or {for: …}"),
        "Wait after the motion is steady, before recording: for a time, or until readings have settled.",
        "30 s",
        traits=StateTraits(swept=True),
    )
    dwell: Quantity | Turns | str | None = optional(
        WordOr(
            ("recorded",),
            ByShape(QuantityOf("time", "positive"), RecordOf(Turns), what="a time, {turns: …} or {cycles: …}"),
        ),
        "How long to record: a time, whole turns or cycles, or 'recorded' for the length of a played-back segment.",
        "2 min",
        traits=StateTraits(swept=True, decisive=True),
    )
    sample_rate: Quantity | None = optional(
        QuantityOf("frequency", "positive"),
        "Samples per second; by default the sample rate of the sensor.",
        "100 Hz",
        traits=StateTraits(swept=True),
    )
    mode: str | None = optional(
        Text(NAME, "a mode's name"),
        "Operating mode in which the sensor records, if its driver offers modes (such as caged and navigation).",
        "navigation",
    )
    watch: WatchSpec | None = optional(
        WATCH,
        "Limits on the readings of the instruments while the segment records.",
        {"position_error": "5 arcsec", "lost_frames": "0.1 %", "retakes": 2},
    )
    on_break: str | None = optional(
        Choice(("retake", "keep")), "When a run is resumed: what to do with a segment that a crash cut short.", "keep"
    )


STATE_KEYS = tuple(keys_of(State))
"""Keys of a state; nested steps inherit each of them."""
STATE_TRAITS: Mapping[str, StateTraits] = {
    name: item.metadata["traits"] or StateTraits() for name, item in keys_of(State).items()
}
"""The traits of each key of a state, in the order of declaration."""


@dataclass(frozen=True, slots=True)
class SweptKey:
    """Describes one key of a state for which `for_each` can state a list of values. `quantity`: the kind of the values if they are
    quantities; otherwise None."""

    name: str
    kind: Kind
    quantity: QuantityOf | None
    directed: bool
    example: object


def _quantity_kind(kind: Kind) -> QuantityOf | None:
    """Returns the kind of quantity in the kind of a swept key; None if the values are not quantities."""
    scalar = kind.other if isinstance(kind, WordOr) else kind
    inner = scalar.scalar if isinstance(scalar, ByShape) else scalar
    return inner if isinstance(inner, QuantityOf) else None


SWEPT_KEYS: Mapping[str, SweptKey] = {
    name: SweptKey(
        name,
        item.metadata["kind"],
        _quantity_kind(item.metadata["kind"]),
        STATE_TRAITS[name].directed,
        STATE_TRAITS[name].sweep_example or [item.metadata["example"]],
    )
    for name, item in keys_of(State).items()
    if STATE_TRAITS[name].swept
}
"""The keys of a state that may be swept."""


@dataclass(frozen=True, slots=True)
class SweepValue:
    """One value of a sweep. `name`: the part of a label that shows the value. `short`: the text that replaces a {placeholder} in a
    label."""

    name: str
    short: str
    value: object
    mark: Mark


@dataclass(frozen=True, slots=True)
class SweepAxis:
    key: str
    values: tuple[SweepValue, ...]


@dataclass(frozen=True, slots=True)
class Sweep:
    mark: Mark
    axes: tuple[SweepAxis, ...]

    @property
    def size(self) -> int:
        size = 1
        for axis in self.axes:
            size *= len(axis.values)
        return size

    def combinations(self, order: str, seed: int) -> Iterator[tuple[SweepValue, ...]]:
        """Returns every combination of the values, with one value for each swept key, in the given order."""
        rows = list(_product(self.axes, serpentine=order == "serpentine"))
        if order == "reversed":
            rows.reverse()
        elif order == "shuffled":
            random.Random(seed).shuffle(rows)
        return iter(rows)


def _product(axes: tuple[SweepAxis, ...], serpentine: bool) -> Iterator[tuple[SweepValue, ...]]:
    if not axes:
        yield ()
        return
    for index, value in enumerate(axes[0].values):
        rest = _product(axes[1:], serpentine)
        if serpentine and index % 2:
            rest = iter(list(rest)[::-1])
        for row in rest:
            yield (value, *row)


_LABEL = r"[^/\x00-\x1f]{1,60}"


class ForEachKind:
    """Reads the value of `for_each`: a sweep over keys of a state that may be swept."""

    def read(self, node: source.Node, log: Findings) -> Sweep | None:
        if not isinstance(node, source.Mapping) or not node.entries:
            log.error(
                "form-type",
                node.mark,
                "for_each must be a mapping of keys to the values of their sweep",
                "write {rate: '±300, ±150 deg/s'}",
            )
            return None
        axes = []
        for name, item in node.entries:
            if name.text not in SWEPT_KEYS:
                log.error(
                    "form-unknown-key", name.mark, f"'{name.text[:60]}' cannot be swept", closest(name.text, SWEPT_KEYS)
                )
                continue
            values = _values(SWEPT_KEYS[name.text], item, log)
            if values:
                axes.append(SweepAxis(name.text, values))
        return Sweep(node.mark, tuple(axes)) if len(axes) == len(node.entries) else None

    def schema(self) -> Schema:
        return {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": False,
            "properties": {name: _swept(item) for name, item in SWEPT_KEYS.items()},
        }


def _swept(key: SweptKey) -> Schema:
    value = key.kind.schema()
    one: Schema = value if key.quantity is None else {"anyOf": [value, signed_schema()]}
    forms: list[Schema] = [
        {"type": "array", "minItems": 1, "items": one},
        {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": value,
            "propertyNames": {"pattern": anchored(_LABEL)},
        },
    ]
    what = "a list, or a mapping of names to values; the names become labels"
    if key.quantity is not None:
        forms.append(sweep_schema())
        what = "a list, a mapping of names to values, or one text with a shared unit, such as '±300, ±150 deg/s'"
    return {"description": f"Values of {key.name}: {what}.", "examples": [key.example], "anyOf": forms}


def _values(key: SweptKey, node: source.Node, log: Findings) -> tuple[SweepValue, ...] | None:
    if isinstance(node, source.Mapping):
        return _named(key.kind, node, log)
    if isinstance(node, source.Sequence):
        if not node.items:
            log.error("form-size", node.mark, "at least one value is needed here", "list the values")
            return None
        before = log.raised
        read = [value for item in node.items for value in _entry(key, item, log)]
        return _labelled(key, read) if log.raised == before else None
    if key.quantity is None:
        log.error(
            "form-type", node.mark, f"{key.name} is swept over a list or a mapping of names", "write {A: …, B: …}"
        )
        return None
    if not isinstance(node.value, str):
        text = node.text[:40] or "nothing"
        log.error(
            "form-type",
            node.mark,
            f"values with a unit are expected here, not {text}",
            "write for example '±300, ±150 deg/s'",
        )
        return None
    if not _is_exact(key.quantity, node, node.value, log):
        return None
    try:
        quantities = parse_sweep(node.value, key.quantity.dimension)
    except QuantityError as error:
        log.error(error.code, node.mark, str(error), error.hint)
        return None
    return _check_signs(key, quantities, node, log)


def _entry(key: SweptKey, item: source.Node, log: Findings) -> list[tuple[object, Mark]]:
    """Returns the values that one entry of a list gives. An entry that is a quantity with both signs gives two values; an entry
    with a finding gives none."""
    if (
        key.quantity is not None
        and isinstance(item, source.Scalar)
        and isinstance(item.value, str)
        and is_signed(item.value)
    ):
        if not _is_exact(key.quantity, item, item.value, log):
            return []
        try:
            quantities = parse_signed(item.value, key.quantity.dimension)
        except QuantityError as error:
            log.error(error.code, item.mark, str(error), error.hint)
            return []
        return [(value.value, value.mark) for value in _check_signs(key, quantities, item, log) or ()]
    value = key.kind.read(item, log)
    return [] if value is None else [(value, item.mark)]


def _is_exact(quantity: QuantityOf, node: source.Scalar, text: str, log: Findings) -> bool:
    """Returns True if a sweep has no value with an uncertainty. If a value states an uncertainty, a finding is added, because the
    uncertainty would not be used."""
    piece = uncertain_piece(text)
    if piece is not None:
        refuse_uncertainty(piece, quantity.elsewhere, node.mark, log)
    return piece is None


def _check_signs(
    key: SweptKey, quantities: list[Quantity], node: source.Scalar, log: Findings
) -> tuple[SweepValue, ...] | None:
    """Returns the values with labels. If the swept key does not accept their signs (for example, a dwell cannot be negative), adds
    a finding and returns None."""
    sign: Sign = "any" if key.quantity is None else key.quantity.sign
    if not all(has_sign(quantity, sign, node.mark, log, key.name) for quantity in quantities):
        return None
    return _labelled(key, [(quantity, node.mark) for quantity in quantities])


def _named(kind: Kind, node: source.Mapping, log: Findings) -> tuple[SweepValue, ...] | None:
    values = []
    for name, item in node.entries:
        if not re.fullmatch(_LABEL, name.text):
            log.error(
                "form-name",
                name.mark,
                f"'{name.text[:60]}' is not a usable label",
                "leave out '/' and control characters",
            )
            continue
        value = kind.read(item, log)
        if value is not None:
            values.append(SweepValue(name.text, name.text, value, item.mark))
    if not node.entries:
        log.error("form-size", node.mark, "at least one value is needed here", "write {name: value, …}")
    return tuple(values) if node.entries and len(values) == len(node.entries) else None


def _labelled(key: SweptKey, values: list[tuple[object, Mark]]) -> tuple[SweepValue, ...]:
    """Returns the values with labels made from their numbers and units. Labels that occur several times get numbers."""
    rows: list[SweepValue] = []
    for index, (value, mark) in enumerate(values, start=1):
        if isinstance(value, Quantity):
            short = _figure(key, value)
            label = short + re.sub(r"[^A-Za-z0-9%]+", "_", value.unit.text).strip("_")
        else:
            short, label = str(index), f"{key.name}{index}"
        rows.append(SweepValue(label, short, value, mark))
    seen: dict[str, int] = {}
    for position, row in enumerate(rows):
        seen[row.name] = seen.get(row.name, 0) + 1
        if seen[row.name] > 1:
            rows[position] = replace(row, name=f"{row.name}#{seen[row.name]}", short=f"{row.short}#{seen[row.name]}")
    return tuple(rows)


def _figure(key: SweptKey, quantity: Quantity) -> str:
    """Returns the number in the label of a swept quantity, in the unit that the plan states. The module's docstring gives the rule
    for signs."""
    figure = f"{quantity.unit.from_si(quantity.value):.9g}"
    if float(figure) == 0:
        return "0"
    return f"+{figure}" if key.directed and not figure.startswith("-") else figure


class SegmentKind:
    """Reads a segment in a plan. The steps of a segment are segments too."""

    def read(self, node: source.Node, log: Findings) -> SegmentSpec | None:
        before = log.raised
        spec: SegmentSpec | None = RecordOf(SegmentSpec).read(node, log)
        if spec is not None and log.raised > before:
            trouble = log.raised - before
            object.__setattr__(spec, "trouble", trouble)
            object.__setattr__(spec, "sound", False)
            object.__setattr__(spec, "own_sound", trouble == sum(step.trouble for step in spec.steps))
        return spec

    def schema(self) -> Schema:
        return {"$ref": "#/$defs/segment"}


class SegmentSpec(State):
    """Declares one entry of `segments`: a state, or a sweep over states, or steps that share one state."""

    label: str | None = optional(
        Text(r"[^\x00-\x1f]{1,80}", "a label"),
        "Name of the segment; {rate}, {temperature} … are replaced by the swept value.",
        "start-zero",
    )
    prompt: str | None = optional(
        Text(r"[^\x00-\x1f]{1,200}", "a line of text"),
        "Instruction or question that the operator must confirm before the segment (or the first of its steps) begins. Until then, the "
        "bench is in its safe state.",
        "Turn the fixture to face {orientation}, then leave the table",
    )
    conditioning: bool = key(
        Boolean(),
        "Marks a segment (with all its steps) that only conditions the sensor, such as a warm-up or a "
        "pause without power. It is recorded, and no warning is given if no estimate uses it.",
        True,
        default=False,
    )
    for_each: Sweep | None = optional(
        ForEachKind(),
        "Repeat for every value. Several keys give all combinations of their values. The first key changes slowest.",
        {"rate": "±300, ±150 deg/s"},
    )
    order: str = key(
        Choice(("as_written", "reversed", "serpentine", "shuffled")),
        "Order of the sweep. With serpentine, every second pass through the values of an inner key runs backwards. shuffled is a "
        "random order, drawn with the seed 'shuffle_seed'.",
        "as_written",
        default="as_written",
    )
    shuffle_seed: int = key(Number(0, 2**31, integer=True), "Seed of a shuffled order.", 7, default=0)
    repeat: int = key(
        Number(1, 10_000, integer=True),
        "Number of times to do the whole segment, including its sweep and steps.",
        3,
        default=1,
    )
    steps: tuple[SegmentSpec, ...] = key(
        ListOf(SegmentKind(), minimum=1),
        "Segments that share this state.",
        [{"label": "start-zero", "dwell": "60 s"}],
        default_factory=tuple,
    )
    # Whether everything could be read; whether everything except the steps could; and the number of errors.
    sound: bool = field(default=True, compare=False)
    own_sound: bool = field(default=True, compare=False)
    trouble: int = field(default=0, compare=False)
