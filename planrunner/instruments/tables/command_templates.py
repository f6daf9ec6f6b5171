"""Commands of an instrument as a bench file writes them: text with named places such as `AXIS{axis}:POS {position}`."""

from __future__ import annotations

import string
from dataclasses import dataclass

from planrunner.base.findings import Findings, closest
from planrunner.instruments.wire.replies import written
from planrunner.plan.kinds import Schema
from planrunner.plan.source import Node, Scalar


@dataclass(frozen=True, slots=True)
class CommandTemplate:
    """One command; `places` are the names that may stand in braces."""

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
    """The command for one axis."""
    return template.format(axis=axis, **{name: written(value) for name, value in values.items()})
