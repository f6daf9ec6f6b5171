"""Every driver of a table or chamber with its simulated instrument, which was written from the same protocol apart from it, as a process
of its own: what the driver asks for is what the simulated world then does."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planrunner.bench.model import read_bench
from planrunner.bench.opening import OpenBench, open_bench
from planrunner.bench.simulation import ask
from planrunner.instruments.interfaces import InstrumentError, OwnLimits
from planrunner.physics.kinematics import rotation_about
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.schedule import Cycle, Move, Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are not for Windows"),
]

SPEED = 30.0
PATIENCE = 240.0
"""Seconds of the wall past which something hangs, however busy the computer is."""
THREE = """axes:
      - {name: outer, direction: up, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}
      - {name: middle, direction: east, max_rate: 200 deg/s, max_acceleration: 100 deg/s^2}
      - {name: inner, direction: north, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}"""
ONE = "axes: [{name: table, direction: up, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}]"
SCPI = """commands:
      limit: ["AXIS{axis}:LIM:RATE {rate}", "AXIS{axis}:LIM:ACC {acceleration}"]
      energise: ["AXIS{axis}:DRIVE ON"]
      go_to: "AXIS{axis}:POS {position}"
      turn: "AXIS{axis}:RATE {rate}"
      stop: "AXIS{axis}:STOP"
      switch_off: ["AXIS{axis}:DRIVE OFF"]
      position: "AXIS{axis}:POS?"
      rate: "AXIS{axis}:RATE?\""""
PAIRS = {
    "words": ("virtual", "acutrol", 'address: "TCPIP::127.0.0.1::9878::SOCKET"', THREE, "watlow_f4t", "framing: words"),
    "ascii": ("virtual", "acutrol", 'address: "TCPIP::127.0.0.1::9878::SOCKET"', THREE, "espec_p300", "framing: ascii"),
    "scpi": (
        "virtual",
        "scpi_table",
        'address: "TCPIP::127.0.0.1::5025::SOCKET"',
        f"{THREE}\n    {SCPI}",
        "thermotron_8800",
        "",
    ),
    "serial": ("virtual_gyro_triad", "aerosmith", 'address: "ASRLtable.port::INSTR"', ONE, "espec_p300", ""),
}


def bench_file(folder: Path, pair: str) -> Path:
    world, driver, address, more, chamber, framing = PAIRS[pair]
    text = f"""planrunner_bench: 1
name: meeting
simulation: {{bench: {world}, control: "127.0.0.1:9870"{", " + framing if framing else ""}}}
site: {{latitude: 39.98 deg, gravity: 9.80154 m/s^2}}
instruments:
  table:
    driver: {driver}
    {address}
    timeout: 1 min
    {more}
  chamber: {{driver: {chamber}, address: "TCPIP::127.0.0.1::5555::SOCKET", timeout: 1 min,
    lowest: -40 degC, highest: 85 degC, ramp: 3 K/min}}
"""
    path = folder / "lab.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@contextmanager
def meeting(folder: Path, pair: str) -> Iterator[tuple[OpenBench, str]]:
    """A bench whose drivers are connected to simulated instruments at `SPEED` times real time, and the place of their control port."""
    ready, copy = folder / "ready.json", folder / "copy.yaml"
    command = [
        sys.executable,
        "-m",
        "planrunner",
        "simulate-bench",
        str(bench_file(folder, pair)),
        "--speed",
        str(SPEED),
    ]
    command += ["--copy", str(copy), "--ready", str(ready)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PLANRUNNER_LOCKS": str(folder / "locks")}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=folder
    )
    try:
        deadline = time.monotonic() + PATIENCE
        while not ready.exists():
            if process.poll() is not None or time.monotonic() > deadline:
                process.kill()
                pytest.fail(f"it does not begin: {process.communicate()[0]}")
            time.sleep(0.05)
        control = json.loads(ready.read_text(encoding="utf-8"))["control"]
        bench, _, _ = read_bench(str(copy))
        with open_bench(bench) as opened:
            yield opened, control
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


def wait_for(bench: OpenBench, holding: Any, seconds: float) -> None:
    end = time.monotonic() + seconds / SPEED + PATIENCE
    while not holding():
        assert time.monotonic() < end
        time.sleep(0.02)


def turned(degrees: float) -> Any:
    return rotation_about((0.0, 0.0, 1.0), math.radians(degrees)).T


def check_cycle(bench: OpenBench, control: str) -> None:
    """Two cycles of turns, one of them the longer way: in the middle of every stop the axis has truly turned as far as the cycle says,
    whole turns counted, which a position that is read does not. A stop takes a second: what is read after it counts for nothing."""
    table: Any = bench.table
    clock = bench.clock
    degrees = (180.0, 90.0, -270.0)
    motion = Cycle({}, tuple(Move("", math.radians(turn), "") for turn in degrees), math.radians(40), 60.0)
    planned = RotationCycle.of(motion, math.radians(200))
    wait_for(bench, table.holding, table.orient(turned(10.0)))

    def truth() -> float:
        return float(ask(control, {"ask": "state"})["table"]["angles"][0])

    home, begun = truth(), clock.now()
    table.begin_motion(motion, 2 * planned.period)
    stop_ends = np.cumsum([60.0 + abs(turn) / 40 + 40 / 200 for turn in degrees])
    seen = 0
    for moment in np.concatenate([stop_ends, planned.period + stop_ends]) + 30.0:
        while clock.now() < begun + moment:
            assert table.watch().faults == ()
            time.sleep(0.02)
        turned_by = truth() - home
        if clock.now() < begun + moment + 28.0:
            seen += 1
            assert turned_by == pytest.approx(float(planned.angle(np.array([moment]))[0]), abs=math.radians(0.03))
    assert seen >= len(degrees)
    wait_for(bench, table.holding, table.end_motion())


@pytest.mark.parametrize("pair", PAIRS)
def test_what_the_driver_asks_for_is_what_the_world_does(
    pair: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(tmp_path / "locks"))
    with meeting(tmp_path, pair) as (bench, control):
        bench.take_control()
        table: Any = bench.table
        chamber: Any = bench.chamber
        table.limit(OwnLimits(rate=math.radians(300)))
        outer = next(iter(table.read()))
        wait_for(bench, table.holding, table.orient(turned(70.0)))
        assert table.read()[outer] == pytest.approx(70.0, abs=0.02)
        truth = math.degrees(ask(control, {"ask": "state"})["table"]["angles"][0])
        assert truth % 360 == pytest.approx(70.0, abs=0.02)

        wait_for(bench, table.holding, table.begin_motion(Spin(math.radians(-30)), 60.0))
        assert table.watch().values["rate_error"] < math.radians(0.03)
        wait_for(bench, table.holding, table.end_motion())
        wait_for(bench, table.holding, table.orient(turned(10.0)))

        rock = Rock(math.radians(3), 0.2, (0.0,), 240.0)
        if table.commands.rocks:
            wait_for(bench, table.holding, table.begin_motion(rock, 300.0))
            seen = [table.read()[outer] for _ in range(60)]
            while min(seen) >= 8.0 or max(seen) <= 12.0:
                assert table.watch().faults == () and len(seen) < 10_000
                seen.append(table.read()[outer])
            assert min(seen) > 6.9 and max(seen) < 13.1
            wait_for(bench, lambda: table.watch().values.get("position_error", 1.0) < math.radians(0.02), 30.0)
            table.end_motion()
        else:
            with pytest.raises(InstrumentError, match="has no rocking motion"):
                table.foresee([Segment(0, "R", None, "", rock, 60.0)])

        check_cycle(bench, control)

        chamber.limit(OwnLimits())
        wait_for(bench, chamber.at_temperature, chamber.set_temperature(30 + ZERO_CELSIUS))
        assert chamber.read()["air_degC"] == pytest.approx(30.0, abs=0.6)
        assert bench.make_safe() == []
        state = ask(control, {"ask": "state"})
        assert np.allclose(state["table"]["rates"], 0.0, atol=math.radians(0.1))
        assert state["chamber"]["target"] == pytest.approx(25 + ZERO_CELSIUS)
        assert [*table.remarks(), *chamber.remarks()] == []
