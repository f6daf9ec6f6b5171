"""Plan keys for segments: states to reach and hold, sweeps over them, and steps with a common state."""

from __future__ import annotations

from dataclasses import field

from planrunner.base.findings import Findings
from planrunner.plan import source
from planrunner.plan.kinds import (
    Boolean,
    ByShape,
    Choice,
    ListOf,
    Number,
    QuantityOf,
    Record,
    RecordOf,
    Schema,
    Text,
    WordOr,
    key,
    keys_of,
    optional,
)
from planrunner.plan.orientation import Orientation, OrientationKind
from planrunner.plan.quantity import Quantity
from planrunner.plan.state import RATE_UNCERTAINTY, STABILITY, WATCH, MotionSpec, StabilitySpec, Turns, WatchSpec
from planrunner.plan.sweep import ForEachKind, StateTraits, Sweep, traits_of

TEMPERATURE_UNCERTAINTY = "`temperature_uncertainty` of the chamber in the bench file"
"""Where the uncertainty of a segment's temperature must be stated."""

NAME = r"[A-Za-z][A-Za-z0-9_-]{0,39}"


class Ramp(Record):
    """A temperature that changes while the segment records."""

    ramp_to: Quantity = key(
        QuantityOf("temperature", elsewhere=TEMPERATURE_UNCERTAINTY),
        "Temperature that the chamber is set to when recording begins.",
        "60 degC",
    )


class State(Record):
    """A state to reach and hold. Nested steps inherit the keys that they do not set.

    A new key is declared here, with its traits: schema, reading, inheritance, sweeps, labels and the reference of keys follow. The
    behaviour of the bench is defined in the schedule.
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
        "Voltage that supplies the sensor. A person sets it, not a driver: ask for it with `prompt`. Virtual sensors follow it.",
        "5 V",
        traits=StateTraits(swept=True, decisive=True, sweep_example="4.5, 5, 5.5 V"),
    )
    ambient_pressure: Quantity | None = optional(
        QuantityOf("pressure", "positive"),
        "Absolute pressure of the air around the sensor. A person sets it, not a driver: ask for it with "
        "`prompt`. Virtual sensors "
        "follow it.",
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


class SegmentKind:
    """A segment. Its steps are segments too."""

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
    """One entry of `segments`: a state, or a sweep over states, or steps that share one."""

    label: str | None = optional(
        Text(r"[^\x00-\x1f]{1,80}", "a label"),
        "Name of the segment; {rate}, {temperature} … are replaced by the swept value.",
        "start-zero",
    )
    prompt: str | None = optional(
        Text(r"[^\x00-\x1f]{1,200}", "a line of text"),
        "Instruction or question that the operator must confirm before the segment begins (before the first of its steps); until then the "
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
        ForEachKind(State),
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


STATE_KEYS = tuple(keys_of(State))
"""Keys of a state; nested steps inherit each of them."""
STATE_TRAITS = traits_of(State)
