"""Every ± that the language accepts is used by something, and every other is refused: all keys of all records, one by one."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import pytest

from planrunner.base import plugins
from planrunner.base.findings import Findings
from planrunner.instruments.parameters import QuantityLike
from planrunner.plan import source
from planrunner.plan.expand import expand
from planrunner.plan.kinds import ByShape, ListOf, MapOf, QuantityOf, Record, WordOr, keys_of
from planrunner.plan.model import parse_plan
from planrunner.plan.units import EXAMPLES

GROUPS = ("planrunner.instruments", "planrunner.estimators")

USED = {
    "SiteSpec.latitude": "planrunner/uncertainty/stated_inputs.py, as `latitude`",
    "SiteSpec.gravity": "planrunner/uncertainty/stated_inputs.py, as `gravity`",
    "SiteSpec.azimuth": "planrunner/uncertainty/stated_inputs.py, as `azimuth`",
    "DeviationOfVertical.north": "planrunner/bench/model.py, with the latitude",
    "MountedAxis.angle": "planrunner/uncertainty/stated_inputs.py, as `fixture angle`",
    "MountedAxis.azimuth": "planrunner/uncertainty/stated_inputs.py, as `fixture azimuth`",
    "Limit.prior": "planrunner/uncertainty/global_risk.py",
    "CheckedCoefficient.reference": "planrunner/night/history/check_standard.py",
    **{
        f"Installation.{pair}": "planrunner/estimators/rocking/influences.py"
        for pair in ("xz", "xy", "yz", "yx", "zy", "zx")
    },
}
"""Keys that take an uncertainty, and who uses it; the tests of these modules show how.

`scale_factors` of allan_deviation has a kind of its own."""


def subclasses(record: type[Record]) -> Iterator[type[Record]]:
    for made in record.__subclasses__():
        yield made
        yield from subclasses(made)


def quantities(kind: Any) -> Iterator[QuantityOf | QuantityLike]:
    """The kinds of quantities within a kind."""
    if isinstance(kind, QuantityOf | QuantityLike):
        yield kind
    elif isinstance(kind, ListOf | MapOf):
        yield from quantities(kind.item)
    elif isinstance(kind, ByShape):
        for part in (kind.scalar, kind.mapping, kind.sequence):
            yield from quantities(part)
    elif isinstance(kind, WordOr):
        yield from quantities(kind.other)


def every_key() -> dict[str, list[QuantityOf | QuantityLike]]:
    for language in ("planrunner.plan.model", "planrunner.bench.model"):
        import_module(language)
    for group in GROUPS:
        for name in plugins.names(group):
            plugins.load(group, name)
    found: dict[str, list[QuantityOf | QuantityLike]] = {}
    for record in subclasses(Record):
        if not record.__module__.startswith("planrunner."):
            continue
        for field in keys_of(record).values():
            inside = list(quantities(field.metadata["kind"]))
            if inside:
                found[f"{record.__name__}.{field.name}"] = inside
    return found


def test_an_uncertainty_is_taken_where_it_is_used_and_nowhere_else() -> None:
    keys = every_key()
    assert len(keys) > 100
    assert {
        name for name, kinds in keys.items() if any(isinstance(k, QuantityOf) and k.uncertain for k in kinds)
    } == set(USED)
    for name, kinds in keys.items():
        for kind in kinds:
            text = EXAMPLES.get(kind.dimension or "", "1 deg/s") if isinstance(kind, QuantityOf) else f"1 {kind.unit}"
            unit = text.split(" ", 1)[1]
            for written in (f"{text} ± 0.1 {unit}", f"{{value: {text}, standard_uncertainty: 0.1 {unit}}}"):
                log = Findings()
                node = source.parse(f"q: {written}", "f").get("q")
                assert node is not None
                read = kind.read(node, log)
                codes = [finding.code for finding in log]
                if name in USED:
                    assert read is not None, (name, written, codes)
                    assert read.standard_uncertainty > 0
                else:
                    assert read is None and codes == ["form-uncertainty-unused"], (name, written, codes)


PLAN = """\
planrunner: 1
title: t
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
defaults: {orientation: {x: up, y: north}}
segments:
  - {label: A, dwell: 10 s, STATE}
"""


@pytest.mark.parametrize(
    ("state", "hint"),
    [
        ("rate: 21.04 deg/s ± 0.15 deg/s", "write 21.04 deg/s; state it as `rate_uncertainty`"),
        ("rate: {value: 21.04 deg/s, half_width: 0.15 deg/s}", "write 21.04 deg/s; state it as `rate_uncertainty`"),
        ("motion: {rate: 21 deg/s ± 0.1 deg/s}", "`rate_stability` of the table"),
        ("temperature: 20 degC ± 0.5", "write 20 degC; state it as `temperature_uncertainty`"),
        ("settle: 5 s ± 1 s", "write 5 s"),
    ],
)
def test_the_finding_says_where_it_is_stated_instead(state: str, hint: str) -> None:
    _, log = parse_plan(PLAN.replace("STATE", state), "plan.yaml")
    found = [(finding.code, finding.mark.line) for finding in log]
    assert found == [("form-uncertainty-unused", 7)]
    assert hint in next(iter(log)).hint


@pytest.mark.parametrize(
    "values", ['"±10, ±20 deg/s ± 0.1"', "[10 deg/s ± 0.1, 20 deg/s]", '["±10 deg/s ± 0.1"]', "{A: 10 deg/s ± 0.1}"]
)
def test_sweeps_refuse_it_too(values: str) -> None:
    text = PLAN.replace("{label: A, dwell: 10 s, STATE}", f"{{dwell: 10 s, for_each: {{rate: {values}}}}}")
    plan, log = parse_plan(text, "plan.yaml")
    if plan is not None:
        expand(plan, log)
    assert "form-uncertainty-unused" in {finding.code for finding in log}


def test_an_uncertainty_of_zero_is_refused_where_it_has_no_meaning() -> None:
    """What is refused hangs on what is written, not on its size."""
    log = Findings()
    node = source.parse("q: 5 s ± 0 s", "f").get("q")
    assert node is not None
    assert QuantityOf("time").read(node, log) is None
