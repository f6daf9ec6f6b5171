"""Other spellings of a plan with the same meaning: for tests. Everything is drawn from a seeded generator.

The rules stand here on their own: decimal arithmetic for units, and a walk over the raw YAML for sweeps.
"""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable, Iterator
from decimal import Decimal, localcontext
from typing import Any

import yaml

from planrunner.base.findings import Findings
from planrunner.plan import source
from planrunner.plan.expand import expand
from planrunner.plan.model import parse_plan

OTHER_UNITS: dict[str, tuple[tuple[str, str], ...]] = {
    "s": (("min", "1/60"), ("ms", "1000"), ("h", "1/3600")),
    "min": (("s", "60"), ("h", "1/60")),
    "h": (("s", "3600"), ("min", "60")),
    "deg": (("arcmin", "60"), ("arcsec", "3600"), ("rev", "1/360")),
    "arcsec": (("arcmin", "1/60"), ("deg", "1/3600")),
    "deg/s": (("dps", "1"), ("deg/h", "3600"), ("rev/min", "1/6")),
    "deg/h": (("deg/s", "1/3600"),),
    "Hz": (("1/s", "1"), ("kHz", "1/1000")),
    "ppm": (("%", "1/10000"),),
    "%": (("1", "1/100"), ("ppm", "10000")),
    "g": (("mg", "1000"),),
    "mg": (("ug", "1000"),),
}
"""Unit → others of the same dimension, with the number of them in one of it."""

_QUANTITY = re.compile(r"(±?)(-?[0-9]+(?:\.[0-9]+)?(?:e-?[0-9]+)?) ([A-Za-z%/]+)")


def tree(text: str) -> Any:
    """A plan as plain data, by the YAML 1.2 meaning of the language."""
    return _data(source.parse(text, "plan"))


def _data(node: source.Node) -> Any:
    if isinstance(node, source.Scalar):
        return node.value
    if isinstance(node, source.Sequence):
        return [_data(item) for item in node.items]
    return {name.text: _data(item) for name, item in node.entries}


def with_other_units(data: Any, rng: random.Random) -> Any:
    """Quantities in other units. Those of a sweep stay, because labels are made of them; so do texts that are no quantities."""
    if isinstance(data, dict):
        return {
            name: item
            if name in ("for_each", "title", "description", "label", "prompt")
            else with_other_units(item, rng)
            for name, item in data.items()
        }
    if isinstance(data, list):
        return [with_other_units(item, rng) for item in data]
    match = _QUANTITY.fullmatch(data) if isinstance(data, str) else None
    if match is None:
        return data
    if match[3] == "degC" and not match[1]:
        return rng.choice((data, f"{Decimal(match[2]) + Decimal('273.15')} K"))
    if match[3] not in OTHER_UNITS or rng.random() < 0.2:
        return data
    unit, factor = rng.choice(OTHER_UNITS[match[3]])
    with localcontext() as context:
        context.prec = 20
        above, _, below = factor.partition("/")
        value = Decimal(match[2]) * Decimal(above) / Decimal(below or "1")
    return f"{match[1]}{value:f} {unit}"


def with_keys_shuffled(data: Any, rng: random.Random) -> Any:
    """Keys in another order, except where their order has a meaning (sweeps), and names that may rest on earlier ones (estimates)."""
    if isinstance(data, list):
        return [with_keys_shuffled(item, rng) for item in data]
    if not isinstance(data, dict):
        return data
    names = list(data)
    rng.shuffle(names)
    made = {}
    for name in names:
        if name == "estimates":
            made[name] = {key: with_keys_shuffled(value, rng) for key, value in data[name].items()}
        else:
            made[name] = data[name] if name == "for_each" else with_keys_shuffled(data[name], rng)
    return made


def written_out(text: str) -> Any:
    """The plan with a segment for each dwell: no defaults, sweeps, steps or repeats."""
    data = tree(text)
    plan, _ = parse_plan(text, "plan")
    assert plan is not None
    labels = [item.label for item in expand(plan, Findings())]
    states = [state for spec in data["segments"] for state in _states(spec, data.get("defaults", {}))]
    assert len(labels) == len(states)
    rest = {name: item for name, item in data.items() if name != "defaults"}
    return {**rest, "segments": [{"label": label, **state} for label, state in zip(labels, states, strict=True)]}


_OWN = ("label", "for_each", "order", "shuffle_seed", "repeat", "steps")


def _states(spec: dict[str, Any], above: dict[str, Any]) -> Iterator[dict[str, Any]]:
    assert spec.get("order", "as_written") == "as_written", "only sweeps in the order as written are written out here"
    own = {name: item for name, item in spec.items() if name not in _OWN}
    for _ in range(spec.get("repeat", 1)):
        for swept in _rows(list(spec.get("for_each", {}).items())):
            state = {**above, **own, **swept}
            if "motion" in own or "motion" in swept:
                state.pop("rate", None) if "rate" not in {**own, **swept} else None
            elif "rate" in own or "rate" in swept:
                state.pop("motion", None)
            if "steps" in spec:
                for step in spec["steps"]:
                    yield from _states(step, state)
            else:
                yield state


def _rows(axes: list[tuple[str, Any]]) -> Iterator[dict[str, Any]]:
    if not axes:
        yield {}
        return
    (name, values), *rest = axes
    if isinstance(values, dict):
        found = list(values.values())
    elif isinstance(values, list):
        found = [one for value in values for one in _signs(value)]
    else:
        pieces = [piece.strip() for piece in values.split(",")]
        unit = pieces[-1].lstrip("±").split(" ", 1)[1]
        found = [one for piece in pieces for one in _signs(piece if " " in piece else f"{piece} {unit}")]
    for value in found:
        for row in _rows(rest):
            yield {name: value, **row}


def _signs(value: Any) -> list[Any]:
    if isinstance(value, str) and value.startswith("±"):
        return [value[1:].strip(), f"-{value[1:].strip()}"]
    return [value]


def block(data: Any, rng: random.Random) -> str:
    """Block style with comments and blank lines."""
    text: str = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=rng.choice((40, 80, 1000)))
    lines = []
    for line in text.splitlines():
        if re.match(r"( *)[a-z_]+:", line) and rng.random() < 0.2:
            lines.append(re.match(r" *", line)[0] + "# a remark: [not, a, value]")  # type: ignore[index]
        lines.append(line)
    return "\n".join(lines) + "\n"


def flow(data: Any, rng: random.Random) -> str:
    """Everything in one flow mapping with quoted texts: JSON is YAML."""
    return json.dumps(data, ensure_ascii=rng.random() < 0.5, indent=rng.choice((None, 1, 7)))


def quoted(data: Any, rng: random.Random) -> str:
    """Block style in which every text is quoted."""

    class Dumper(yaml.SafeDumper):
        pass

    def text(dumper: yaml.SafeDumper, value: str) -> yaml.ScalarNode:
        return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=rng.choice("'\""))

    Dumper.add_representer(str, text)
    written: str = yaml.dump(data, Dumper=Dumper, sort_keys=False, allow_unicode=True)
    return written


STYLES: tuple[Callable[[Any, random.Random], str], ...] = (block, flow, quoted)


def respelled(text: str, rng: random.Random, expanded: bool = False) -> str:
    """Another spelling of a plan with the same meaning. expanded: with a segment for each dwell."""
    data = written_out(text) if expanded else tree(text)
    return rng.choice(STYLES)(with_keys_shuffled(with_other_units(data, rng), rng), rng)
