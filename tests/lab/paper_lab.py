"""A laboratory on paper: a table, a chamber and a sensor whose state is a line in a file each, so that it outlives whoever commanded them.

The drivers behave as real ones do: on the wall clock, with an address, their own limits, readings and faults. A test reads the files to
see what state the instruments were left in, and writes `faults` files to break them. `packaged` makes them known to other processes.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planrunner.instruments.interfaces import Block, Condition, InstrumentError, OwnLimits, Surroundings
from planrunner.instruments.models import ChamberModel, OutputModel, SensorModel, TableModel
from planrunner.physics.kinematics import TableAxis
from planrunner.plan.kinds import Record, Text, key
from planrunner.plan.schedule import Motion, Segment, Spin

ENTRIES = "[planrunner.instruments]\n" + "".join(
    f"paper_{name.lower()} = paper_lab:Paper{name}\n" for name in ("Table", "Chamber", "Sensor")
)


def packaged(folder: Path) -> dict[str, str]:
    """An environment in which planrunner finds these drivers; `folder` takes the package's description."""
    info = folder / "site" / "paper_lab-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: paper-lab\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(ENTRIES, encoding="utf-8")
    path = os.pathsep.join([str(info.parent), str(Path(__file__).parent)])
    return {**os.environ, "PYTHONPATH": path, "PLANRUNNER_LOCKS": str(folder / "locks"), "OPENBLAS_NUM_THREADS": "1"}


def bench_file(folder: Path, more: str = "", instruments: str = "table, chamber, sensor") -> Path:
    """A bench file of the paper laboratory in `folder`."""
    named = "".join(
        f"  {name.strip()}: {{driver: paper_{name.strip()}, file: {folder / (name.strip() + '.json')}}}\n"
        for name in instruments.split(",")
    )
    text = f"planrunner_bench: 1\nname: paper\nclock: wall\nsite: {{latitude: 40 deg, gravity: 9.8 m/s^2}}\n{more}instruments:\n{named}"
    path = folder / "paper.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def state(folder: Path, name: str) -> dict[str, Any]:
    """What an instrument was last told."""
    for _ in range(100):
        try:
            found: dict[str, Any] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
            return found
        except (OSError, ValueError):  # just being written
            time.sleep(0.01)
    raise AssertionError(f"{name} was never told anything")


class PaperParameters(Record):
    file: str = key(Text(), "File that holds the instrument's state.", "table.json")


class Paper:
    """What all of them do: remember what they were told, and who told it."""

    Parameters = PaperParameters

    def __init__(self, parameters: PaperParameters, surroundings: Surroundings):
        self.file, self.clock = Path(parameters.file), surroundings.clock
        if self.fault() == "refuses the connection":
            raise InstrumentError("somebody else holds its port")
        if self.fault() == "hangs when connected":
            time.sleep(3600)
        self.write(connections=self.known().get("connections", 0) + 1)

    @classmethod
    def address(cls, parameters: PaperParameters) -> str:
        return f"paper {parameters.file}"

    @classmethod
    def connect(cls, parameters: PaperParameters, surroundings: Surroundings) -> Any:
        return cls(parameters, surroundings)

    def known(self) -> dict[str, Any]:
        try:
            found: dict[str, Any] = json.loads(self.file.read_text(encoding="utf-8"))
            return found
        except (OSError, ValueError):
            return {}

    def write(self, **told: Any) -> None:
        aside = self.file.with_suffix(f".{os.getpid()}.aside")
        aside.write_text(json.dumps({**self.known(), **told, "by": os.getpid()}), encoding="utf-8")
        aside.replace(self.file)

    def fault(self) -> str:
        """What is written in the instrument's faults file: `hang`, `exit`, `refuse`, `refuses the connection`, `hangs when connected`,
        `hangs when made safe`, `refuses limits`, `goes on with LABEL` for a segment that does not end, or words for its condition."""
        path = self.file.with_suffix(".faults")
        return path.read_text(encoding="utf-8").strip() if path.exists() else ""

    def identify(self) -> Mapping[str, str]:
        return {"model": type(self).__name__, "serial": "1"}

    def make_safe(self) -> None:
        if self.fault() == "refuse":
            raise InstrumentError("it does not answer")
        if self.fault() == "hangs when made safe":
            time.sleep(3600)
        self.write(safe=True, rate=0.0, kelvin=298.15)

    def close(self) -> None:
        self.write(closed=True)

    def watch(self) -> Condition:
        fault = self.fault()
        if fault == "hang":
            time.sleep(3600)
        harmless = fault in ("", "refuse", "exit") or fault.startswith("goes on")
        return Condition(faults=() if harmless else (fault,))


class PaperTable(Paper):
    """A table on paper."""

    role = "table"

    @classmethod
    def model(cls, parameters: PaperParameters) -> TableModel:
        return TableModel((TableAxis("outer", (0.0, 0.0, 1.0), 10.0, 10.0),))

    def limit(self, limits: OwnLimits) -> Sequence[str]:
        if self.fault() == "refuses limits":
            raise InstrumentError("it keeps another limit")
        self.write(limits=[limits.rate, limits.silence], limited_before_moving=not self.known().get("moved", False))
        return [f"rate at most {limits.rate} rad/s", f"stops by itself after {limits.silence} s of silence"]

    def orient(self, attitude: Any) -> float:
        self.write(moved=True, safe=False)
        return 0.05

    def holding(self) -> bool:
        return True

    def begin_motion(self, motion: Motion, seconds: float) -> float:
        self.write(rate=motion.rate if isinstance(motion, Spin) else 0.1, moved=True, safe=False)
        return 0.05

    def end_motion(self) -> float:
        self.write(rate=0.0)
        return 0.05


class PaperChamber(Paper):
    """A chamber on paper."""

    role = "chamber"

    @classmethod
    def model(cls, parameters: PaperParameters) -> ChamberModel:
        return ChamberModel(223.15, 358.15, 10.0)

    def set_temperature(self, kelvin: float) -> float:
        self.write(kelvin=kelvin, safe=False)
        return 0.05

    def at_temperature(self) -> bool:
        return True


class PaperSensor(Paper):
    """A sensor on paper: ten blocks of ten rows a second."""

    role = "sensor"

    @classmethod
    def model(cls, parameters: PaperParameters) -> SensorModel:
        return SensorModel("paper-gyro", (OutputModel("rate", "deg/s"),), 100.0)

    def channels(self) -> Mapping[str, str]:
        return {"rate": "deg/s"}

    def stream(self, segment: Segment) -> Iterator[Block]:
        blocks = round((segment.dwell or 1.0) * 10)
        for _ in range(blocks):
            if self.fault() == "exit":
                os._exit(7)  # as a crash within a driver's library does
            if self.fault() == "hang":
                time.sleep(3600)
            self.clock.sleep(0.1)
            time_of = self.clock.now() + np.arange(-9, 1) / 100
            yield Block(time_of, {"rate": np.zeros(10)})
        while self.fault() == f"goes on with {segment.label}":
            self.clock.sleep(0.1)
            yield Block(np.zeros(0), {"rate": np.zeros(0)})
