"""Declares the bench-file keys that every table has, whether simulated or real: its axes and its declared uncertainties."""

from __future__ import annotations

import math

from planrunner.base.findings import Findings
from planrunner.instruments.models import TableModel
from planrunner.physics.kinematics import TableAxis, Unreachable, check_geometry
from planrunner.plan import source
from planrunner.plan.directions import DIRECTIONS
from planrunner.plan.kinds import Choice, ListOf, QuantityOf, Record, RecordOf, Schema, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity


class AxisSpec(Record):
    """Declares the bench-file keys of one axis of a table."""

    name: str = key(Text(r"[^\x00-\x1f]{1,40}", "a name"), "Name of the axis.", "outer")
    direction: str = key(
        Choice(tuple(DIRECTIONS)), "Direction of the axis when all joints are at zero and the azimuth is zero.", "up"
    )
    max_rate: Quantity = key(QuantityOf("angular rate", "positive"), "Highest rate.", "400 deg/s")
    max_acceleration: Quantity = key(
        QuantityOf("angular acceleration", "positive"), "Highest acceleration.", "200 deg/s^2"
    )
    lowest: Quantity | None = optional(
        QuantityOf("angle"), "Lower joint limit; an axis without limits is continuous (slip rings).", "-100 deg"
    )
    highest: Quantity | None = optional(QuantityOf("angle"), "Upper joint limit.", "100 deg")

    def axis(self) -> TableAxis:
        return TableAxis(
            self.name,
            DIRECTIONS[self.direction],
            self.max_rate.value,
            self.max_acceleration.value,
            -math.inf if self.lowest is None else self.lowest.value,
            math.inf if self.highest is None else self.highest.value,
        )


class AxesKind:
    """Reads the axes of a table, the outermost first: one to three axes, each perpendicular to the axis that carries it."""

    def __init__(self, spec: type[AxisSpec] = AxisSpec):
        self._list = ListOf(RecordOf(spec), minimum=1)

    def read(self, node: source.Node, log: Findings) -> tuple[AxisSpec, ...] | None:
        before = log.raised
        specs: tuple[AxisSpec, ...] | None = self._list.read(node, log)
        if specs is None or log.raised > before:
            return None
        for spec in specs:
            if spec.lowest is not None and spec.highest is not None and spec.lowest.value >= spec.highest.value:
                log.error("meaning-axis-limits", spec.at("lowest"), "lowest is not below highest", "exchange them")
            elif spec.axis().lowest > 0 or spec.axis().highest < 0:
                log.error(
                    "meaning-axis-limits",
                    spec.origin.mark,
                    "the limits do not include the joint angle zero",
                    "include 0 deg",
                )
        names = [spec.name for spec in specs]
        for index, spec in enumerate(specs):
            if spec.name in names[:index]:
                message = f"two axes are called '{spec.name}'"
                log.error("meaning-table-axes", spec.at("name"), message, "give each a different name")
        try:
            check_geometry([spec.axis() for spec in specs])
        except Unreachable as error:
            log.error("meaning-table-axes", node.mark, str(error), "list the axes outermost first")
        return None if log.raised > before else specs

    def schema(self) -> Schema:
        return {**self._list.schema(), "maxItems": 3}


class TableKeys(Record):
    """Declares the bench-file keys that all tables have in common; planning uses them."""

    axes: tuple[AxisSpec, ...] = key(
        AxesKind(),
        "The axes, outermost first, one to three.",
        [{"name": "outer", "direction": "up", "max_rate": "400 deg/s", "max_acceleration": "200 deg/s^2"}],
    )
    position_uncertainty: Quantity = key(
        QuantityOf("angle", "not negative"),
        "Declared standard uncertainty of an orientation.",
        "3 arcsec",
        default=parse_quantity("0 arcsec"),
    )
    orthogonality: Quantity = key(
        QuantityOf("angle", "not negative"),
        "Declared standard uncertainty of the right angles between neighbouring axes.",
        "5 arcsec",
        default=parse_quantity("0 arcsec"),
    )
    rate_stability: Quantity = key(
        QuantityOf("ratio", "not negative"),
        "Declared relative standard uncertainty of a rate.",
        "10 ppm",
        default=parse_quantity("0 ppm"),
    )

    def model(self) -> TableModel:
        axes = tuple(spec.axis() for spec in self.axes)
        return TableModel(axes, self.position_uncertainty.value, self.rate_stability.value, self.orthogonality.value)
