"""Drives tables with SCPI-like commands. No standard defines the names of these commands, so the bench file declares them.

After every command without a reply, the error queue is queried, so that a rejected command is detected at once.

In the bench file, a command is a text with placeholders, such as `AXIS{axis}:POS {position}`.
"""

from __future__ import annotations

import re
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from planrunner.base.findings import Findings, closest
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.models import TableModel
from planrunner.instruments.tables.axis_commands import AxisBounds, AxisCommands, AxisState, Sine
from planrunner.instruments.tables.axis_table import LinkedTableKeys, TableDriver
from planrunner.instruments.tables.wired_axes import counted
from planrunner.instruments.wire.links import LineAnswers, LinkedCommands, LinkSettings, MessageLink
from planrunner.instruments.wire.replies import identification, number, written
from planrunner.plan.kinds import Choice, ListOf, Record, RecordOf, Schema, Text, key, optional
from planrunner.plan.source import Node, Scalar


@dataclass(frozen=True, slots=True)
class CommandTemplate:
    """Reads a command that is a text with placeholders. `places`: the names that may appear in braces in the text."""

    places: tuple[str, ...]

    def read(self, node: Node, log: Findings) -> str | None:
        if not isinstance(node, Scalar) or not isinstance(node.value, str) or not node.value.strip():
            log.error(
                "form-type", node.mark, "a command as text is expected here", "write for example 'AXIS{axis}:STOP'"
            )
            return None
        try:
            named = [name for _, name, form, conversion in string.Formatter().parse(node.value) if name is not None]
        except ValueError as error:
            log.error(
                "meaning-command", node.mark, f"'{node.value[:60]}' is not a command: {error}", "close every brace"
            )
            return None
        for name in named:
            if name not in self.places:
                message = f"'{{{name}}}' is not a parameter of this command"
                log.error("meaning-command", node.mark, message, closest(name, self.places))
                return None
        return node.value

    def schema(self) -> Schema:
        return {"type": "string", "minLength": 1}


def filled(template: str, axis: int, **values: float) -> str:
    """Returns the command that a template gives for this axis number and these values."""
    return template.format(axis=axis, **{name: written(value) for name, value in values.items()})


ENDS = {"LF": "\n", "CR": "\r", "CRLF": "\r\n"}
NO_ERROR = re.compile(r"[+-]?0+\s*(,|$)")
LIMITS = ("axis", "rate", "acceleration", "tracking_error")
SINE = ("axis", "amplitude", "frequency", "phase")


class TableCommands(Record):
    """Keys with the commands of a table. The placeholder `{axis}` is replaced by the number of the axis. The other placeholders are
    replaced by values in degrees, deg/s and Hz."""

    identify: str = key(Text(), "Asks for the identification.", "*IDN?", default="*IDN?")
    error: str = key(
        Text(),
        "Asks for the oldest error; an answer that begins with 0 means no error.",
        "SYST:ERR?",
        default="SYST:ERR?",
    )
    limit: tuple[str, ...] = key(
        ListOf(CommandTemplate(LIMITS)),
        "Set the limits that the controller enforces; with {rate}, {acceleration} and {tracking_error}.",
        ["AXIS{axis}:LIM:RATE {rate}", "AXIS{axis}:LIM:ACC {acceleration}"],
        default_factory=tuple,
    )
    energise: tuple[str, ...] = key(
        ListOf(CommandTemplate(("axis",))),
        "Switch the drive of an axis on.",
        ["AXIS{axis}:DRIVE ON"],
        default_factory=tuple,
    )
    go_to: str | None = optional(
        CommandTemplate(("axis", "position")), "Go to a {position} and stay there.", "AXIS{axis}:POS {position}"
    )
    turn: str | None = optional(
        CommandTemplate(("axis", "rate")), "Turn at a {rate}, which can be zero.", "AXIS{axis}:RATE {rate}"
    )
    rock: str | None = optional(
        CommandTemplate(SINE),
        "Rock about the present position with {amplitude}, {frequency} and {phase}; amplitude zero ends it.",
        "AXIS{axis}:SINE {amplitude},{frequency},{phase}",
    )
    stop: str = key(CommandTemplate(("axis",)), "Bring an axis to rest under control.", "AXIS{axis}:STOP")
    switch_off: tuple[str, ...] = key(
        ListOf(CommandTemplate(("axis",))),
        "Switch the drive of an axis off.",
        ["AXIS{axis}:DRIVE OFF"],
        default_factory=tuple,
    )
    position: str = key(CommandTemplate(("axis",)), "Asks for the position in degrees.", "AXIS{axis}:POS?")
    rate: str = key(CommandTemplate(("axis",)), "Asks for the rate in deg/s.", "AXIS{axis}:RATE?")


class ScpiTableParameters(LinkedTableKeys):
    """Declares the bench-file keys of a table whose commands the bench file declares."""

    ends: str = key(Choice(tuple(ENDS)), "Terminator of a message, in both directions.", "LF", default="LF")
    commands: TableCommands = key(
        RecordOf(TableCommands),
        "The table's commands.",
        {"stop": "AXIS{axis}:STOP", "position": "AXIS{axis}:POS?", "rate": "AXIS{axis}:RATE?"},
    )


class ScpiTable(TableDriver[ScpiTableParameters]):
    """A table with SCPI-like commands, declared in the bench file."""

    Parameters = ScpiTableParameters

    @classmethod
    def model(cls, parameters: ScpiTableParameters) -> TableModel:
        return replace(parameters.model(), rocks=parameters.commands.rock is not None)

    @classmethod
    def commands_of(cls, parameters: ScpiTableParameters) -> AxisCommands:
        return ScpiTableCommands(parameters)


class ScpiTableCommands(LinkedCommands):
    """Implements the operations of `AxisCommands` by sending the commands that the bench file declares."""

    def __init__(self, parameters: ScpiTableParameters):
        end = ENDS[parameters.ends]
        settings = LinkSettings(parameters.address, parameters.timeout.value, end, baud=parameters.baud)
        self.link = MessageLink(settings, LineAnswers(end.encode()))
        self.parameters, self.commands = parameters, parameters.commands
        self.axes = [axis.number for axis in counted(parameters)]
        self.rocks = self.commands.rock is not None

    def identify(self) -> Mapping[str, str]:
        said = self.link.query(self.commands.identify)
        self.parameters.check_identity(said, "")
        return identification(said)

    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        values = {"rate": bounds.rate, "acceleration": bounds.acceleration, "tracking_error": bounds.tracking_error}
        made = [filled(template, axis, **values) for template in self.commands.limit]
        if made:
            self._do(made)
        return [f"axis {axis}: {command}" for command in made]

    def energise(self) -> None:
        self._do([filled(template, axis) for axis in self.axes for template in self.commands.energise])

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        template = self._known(self.commands.go_to, "go_to", "a position")
        self._do([filled(template, axis, position=position) for axis, position in positions.items()])

    def turn(self, axis: int, rate: float) -> None:
        self._do([filled(self._known(self.commands.turn, "turn", "a rate"), axis, rate=rate)])

    def rock(self, sines: Mapping[int, Sine]) -> None:
        template = self._known(self.commands.rock, "rock", "rocking")
        self._do(
            [
                filled(template, axis, amplitude=sine.amplitude, frequency=sine.frequency, phase=sine.phase)
                for axis, sine in sines.items()
            ]
        )

    def state(self, axis: int) -> AxisState:
        position = number(self.link, filled(self.commands.position, axis))
        return AxisState(position, number(self.link, filled(self.commands.rate, axis)))

    def faults(self) -> Sequence[str]:
        error = self._error(())
        return [f"it reports {error[:80]}"] if error else []

    def stop(self) -> None:
        self.link.write(*(filled(self.commands.stop, axis) for axis in self.axes))

    def switch_off(self) -> None:
        commands = [filled(template, axis) for axis in self.axes for template in self.commands.switch_off]
        if commands:
            self.link.write(*commands)

    def _do(self, commands: Sequence[str]) -> None:
        error = self._error(commands)
        if error:
            raise InstrumentError(f"the table rejects one of the commands {', '.join(commands)}: {error[:80]}")

    def _error(self, commands: Sequence[str]) -> str:
        """Sends commands and returns the error that the table then reports; empty if there is none."""
        said = self.link.query(self.commands.error, after=commands, again=False)
        return "" if NO_ERROR.match(said) else said or "an empty error message"

    def _known(self, template: str | None, name: str, what: str) -> str:
        if template is None:
            raise InstrumentError(
                f"the bench file does not give a command for {what} of this table: add commands.{name}, if the table has such a command"
            )
        return template
