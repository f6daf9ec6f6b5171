"""Kinds of parameter that instruments have beside the language's own: quantities of a sensor's compound dimensions."""

from __future__ import annotations

from dataclasses import dataclass

from planrunner.plan.findings import Findings
from planrunner.plan.kinds import Schema
from planrunner.plan.quantity import Quantity, read_quantity
from planrunner.plan.quantity import schema as quantity_schema
from planrunner.plan.source import Node
from planrunner.plan.units import unit


@dataclass(frozen=True, slots=True)
class QuantityLike:
    """A quantity of the dimension of `unit`, such as `(deg/h)/(pulse/s)`; `sign` as for `QuantityOf`."""

    unit: str
    sign: str = "any"

    def read(self, node: Node, log: Findings) -> Quantity | None:
        quantity = read_quantity(node, None, log)
        if quantity is None:
            return None
        if quantity.unit.dimension != unit(self.unit).dimension:
            message = f"'{quantity.unit.text}' does not fit here; a unit such as {self.unit} is needed"
            log.error("meaning-dimension", node.mark, message, f"write for example '1 {self.unit}'")
            return None
        if (self.sign == "positive" and quantity.value <= 0) or (self.sign == "not negative" and quantity.value < 0):
            log.error("meaning-range", node.mark, f"{quantity} must be {self.sign}", "change the number")
            return None
        return quantity

    def schema(self) -> Schema:
        return quantity_schema(None)
