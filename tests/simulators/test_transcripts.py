"""The simulated tables and chambers say what the transcripts say, which were written from the protocols apart from them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bench_pieces
import pytest

from planrunner.plan.units import ZERO_CELSIUS
from planrunner.simulators.acutrol import Acutrol
from planrunner.simulators.aerosmith import Aerosmith
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.espec_p300 import EspecP300
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.scpi_table import ScpiTable
from planrunner.simulators.table_plant import TablePlant
from planrunner.simulators.thermotron_8800 import Thermotron8800
from planrunner.simulators.watlow_f4t import WatlowF4t

TRANSCRIPTS = sorted((Path(__file__).parents[1] / "wire" / "transcripts").glob("*.txt"))
TABLES = {"acutrol": Acutrol, "scpi_table": ScpiTable, "aerosmith": Aerosmith}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def numbers(text: str) -> list[float]:
    return [float(word) for word in NUMBER.findall(text)]


def built(header: dict[str, str]) -> tuple[LiveWorld, Any]:
    """The live world of a transcript and the instrument in its state at the beginning."""
    name = header["instrument"]
    if name in TABLES:
        rate, acceleration = numbers(header["limits"])[:2]
        live = bench_pieces.with_table(bench_pieces.axis("only", "up", rate, acceleration))
        return live, TABLES[name](TablePlant(live))
    lowest, highest, ramp = numbers(header["limits"])[:3]
    start = header["start"]
    (measured,) = map(float, re.findall(r"(-?[\d.]+) degC", start)[:1])
    (set_to,) = map(float, re.findall(r"set(?: point)? (-?[\d.]+)", start)[:1])
    live = bench_pieces.with_chamber(lowest, highest, ramp, measured)
    plant = ChamberPlant(live)
    plant.setpoint = set_to + ZERO_CELSIUS
    if re.search(r"\b(running|constant|output 1 on)\b", start):
        plant.regulate()
    if name == "espec_p300":
        address = re.search(r"address (\d+)", start)
        unit = EspecP300(plant, address=int(address[1]) if address else None)
        unit.mode = "CONSTANT" if "constant" in start else "STANDBY"
        return live, unit
    return live, {"watlow_f4t": WatlowF4t, "thermotron_8800": Thermotron8800}[name](plant)


def happens(instrument: Any, event: str) -> None:
    plant = instrument.plant
    if event == "interlock opens":
        plant.open_interlock()
        plant.open_interlock(False)
    elif found := re.fullmatch(r"axis (\d+) (over-rate|tracking error)", event):
        plant.fail(int(found[1]) - 1, found[2])
    elif found := re.fullmatch(r"alarm (\d+)", event):
        plant.alarm(int(found[1]))
    else:
        assert event == "process alarm high"
        plant.alarm(ChamberPlant.OVER)


def same(reply: str, expected: str, within: float) -> bool:
    """Whether a reply has the same words, and numbers no further off than `within`; `*` stands for any number."""
    pattern = re.compile(r"\*|" + NUMBER.pattern)
    if NUMBER.sub("#", reply) != pattern.sub("#", expected):
        return False
    pairs = zip(numbers(reply), pattern.findall(expected), strict=True)
    return all(word == "*" or math.isclose(value, float(word), abs_tol=within, rel_tol=0) for value, word in pairs)


def script(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if line and not line.startswith("#"))


@pytest.mark.parametrize("path", TRANSCRIPTS, ids=lambda path: path.stem)
def test_instrument_says_what_the_transcript_says(path: Path) -> None:
    head, _, body = path.read_text(encoding="utf-8").partition("\n\n")
    header = dict(line.split(": ", 1) for line in script(head))
    live, instrument = built(header)
    prompts = header["framing"] == "prompt"
    pending: str | None = None
    for line in script(body):
        mark, _, rest = line.partition(" ")
        if mark.startswith("<"):
            assert pending is not None, f"{line!r}: nothing was answered"
            if mark == "<":
                assert pending == rest
            elif mark == "<~":
                assert same(pending, rest, float(header["within"])), f"{pending!r} is not {rest!r}"
            else:
                assert pending
            pending = None
            continue
        assert pending is None or (prompts and pending == ""), f"{pending!r} was answered, before {line!r}"
        pending = None
        if mark == ">":
            pending = instrument.answer(rest)
        elif rest.startswith("wait"):
            count, unit = rest.split()[1:]
            bench_pieces.clock_of(live).time += float(count) * {"s": 1.0, "min": 60.0}[unit]
            instrument.watch()
            instrument.later()
        else:
            happens(instrument, rest.removeprefix("event "))
    assert pending is None


def test_there_is_a_transcript_of_every_table_and_chamber() -> None:
    spoken = {path.read_text(encoding="utf-8").split("instrument: ")[1].split("\n")[0] for path in TRANSCRIPTS}
    assert spoken == {"acutrol", "scpi_table", "aerosmith", "espec_p300", "thermotron_8800", "watlow_f4t"}
