"""What a plan says of motion: the records of `motion` and of a dwell in whole turns. `planrunner.plan.motion` gives them meaning."""

from __future__ import annotations

from planrunner.plan.directions import DIRECTIONS
from planrunner.plan.kinds import Choice, ListOf, MapOf, Number, QuantityOf, Record, RecordOf, Text, key
from planrunner.plan.quantity import Quantity

RATE_UNCERTAINTY = (
    "`rate_uncertainty` of a scale-factor estimate, or as `rate_stability` of the table in the bench file"
)
"""Where the uncertainty of a rate is stated."""


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


POSITION = r"[^ \x00-\x1f]{1,20}"
_TURN = r"[-+−]?(?:[0-9]{1,6}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})"
MOVE = rf" *(?P<start>{POSITION}) +(?P<turn>{_TURN}) *(?:deg|°)? +(?P<end>{POSITION}) *"


class Motion(Record):
    """What the table does while the segment records. One of rate, rock and cycle; at rest without any."""

    rate: Quantity | None = key(
        QuantityOf("angular rate", elsewhere=RATE_UNCERTAINTY),
        "Constant rate about the rotation axis.",
        "300 deg/s",
        default=None,
    )
    about: str = key(
        Choice(tuple(DIRECTIONS)),
        "Site direction the table spins about.",
        "up",
        default="up",
    )
    rock: RockSpec | None = key(
        RecordOf(RockSpec), "Sinusoidal rocking.", {"amplitude": "3 deg", "frequency": "0.2 Hz"}, default=None
    )
    for_: Quantity | None = key(
        QuantityOf("time", "positive"),
        "Rock at full amplitude for this part of the dwell only, then rest.",
        "8 min",
        default=None,
        name="for",
    )
    after: Quantity | None = key(
        QuantityOf("time", "positive"),
        "Rest for this part of the dwell, then begin to rock; by default the rocking begins one period before the "
        "dwell.",
        "60 s",
        default=None,
    )
    cycle: dict[str, Quantity] | None = key(
        MapOf(QuantityOf("angle"), pattern=POSITION),
        "Named positions of an indexing cycle.",
        {"A": "0 deg", "B": "90 deg", "C": "180 deg", "D": "270 deg"},
        default=None,
    )
    moves: tuple[str, ...] = key(
        ListOf(Text(MOVE, "a move such as 'A +180 C'", "write from, turn in degrees, to"), minimum=1),
        "Moves of one cycle in order: from, turn in degrees, to.",
        ["A +180 C", "C -180 A"],
        default_factory=tuple,
    )
    turn_rate: Quantity | None = key(
        QuantityOf("angular rate", "positive"), "Rate of the turns between stops.", "10 deg/s", default=None
    )
    stop: Quantity | None = key(
        QuantityOf("time", "not negative"), "Time at each stop; `0 s` for turns without stops.", "3 min", default=None
    )
    sense: str = key(
        Choice(("counterclockwise", "clockwise")),
        "Sense of positive angles, seen against the rotation axis.",
        "clockwise",
        default="counterclockwise",
    )


class Turns(Record):
    """A dwell counted in whole turns of a spinning table, or in whole cycles of turns and stops."""

    turns: int | None = key(Number(1, 1_000_000, integer=True), "Record for this many whole turns.", 1, default=None)
    cycles: int | None = key(Number(1, 1_000_000, integer=True), "Record for this many whole cycles.", 34, default=None)
    at_least: Quantity | None = key(
        QuantityOf("time", "positive"),
        "Add whole turns or cycles until the dwell lasts this long.",
        "30 s",
        default=None,
    )
