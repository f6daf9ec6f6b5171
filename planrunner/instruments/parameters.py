"""Defines two kinds of keys that only instruments need: quantities with the compound units of a sensor, and polynomials of the
temperature."""

from __future__ import annotations

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings
from planrunner.instruments.models import NOMINAL_SUPPLY
from planrunner.plan.kinds import QuantityOf, Schema, Sign, has_sign, key
from planrunner.plan.quantity import Quantity, parse_quantity, read_quantity
from planrunner.plan.quantity import schema as quantity_schema
from planrunner.plan.source import Node, Sequence
from planrunner.plan.units import unit


@dataclass(frozen=True, slots=True)
class QuantityLike:
    """Reads a quantity with the dimension of `unit`, such as `(deg/h)/(pulse/s)`, or of one of the units in `others`. `sign`: the
    same as in `QuantityOf`."""

    unit: str
    sign: Sign = "any"
    others: tuple[str, ...] = ()

    @property
    def what(self) -> str:
        """Returns the text that describes the quantity in the reference of the bench-file keys."""
        sign = {"positive": ", above zero", "not negative": ", zero or more"}.get(self.sign, "")
        return f"a quantity with a unit such as {self.unit}{sign}"

    def read(self, node: Node, log: Findings) -> Quantity | None:
        quantity = read_quantity(node, None, log, uncertain=False)
        if quantity is None:
            return None
        units = (self.unit, *self.others)
        if all(quantity.unit.dimension != unit(text).dimension for text in units):
            message = (
                f"'{quantity.unit.text}' is not a possible unit here; a unit such as {' or '.join(units)} is needed"
            )
            log.error("meaning-dimension", node.mark, message, f"write for example '1 {self.unit}'")
            return None
        return quantity if has_sign(quantity, self.sign, node.mark, log) else None

    def schema(self) -> Schema:
        return quantity_schema(None, uncertain=False)


@dataclass(frozen=True, slots=True)
class Polynomial:
    """Reads the coefficients of (T − T₀), (T − T₀)² and (T − T₀)³, in `unit`/K, `unit`/K^2 and `unit`/K^3. At least the first
    coefficient must be given."""

    unit: str

    def read(self, node: Node, log: Findings) -> tuple[Quantity, ...] | None:
        if not isinstance(node, Sequence) or not 1 <= len(node.items) <= 3:
            hint = f"write for example [0.01 {self._unit(1)}]"
            log.error("form-type", node.mark, "a list of one to three temperature coefficients is expected here", hint)
            return None
        found = [QuantityLike(self._unit(power)).read(item, log) for power, item in enumerate(node.items, start=1)]
        return None if None in found else tuple(item for item in found if item is not None)

    def schema(self) -> Schema:
        return {"type": "array", "minItems": 1, "maxItems": 3, "items": quantity_schema(None, uncertain=False)}

    def _unit(self, power: int) -> str:
        return f"{self.unit}/K" + (f"^{power}" if power > 1 else "")


def nominal_supply() -> Quantity:
    """Makes the key that states the nominal supply voltage of a sensor. At this voltage, the effects of the supply are zero."""
    voltage: Quantity = key(
        QuantityOf("voltage", "positive"),
        "Supply voltage at which the effects of the supply are zero. It also applies to segments that state no "
        "supply voltage.",
        "12 V",
        default=parse_quantity(f"{NOMINAL_SUPPLY:g} V"),
    )
    return voltage
