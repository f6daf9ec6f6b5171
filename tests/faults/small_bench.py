"""A small laboratory for faults: a table with two axes, a quick chamber and a sensor, simulated in a process of their own, and a plan
of three short segments for it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forked_runs import Forks, Run
from small_sensors import FLEXURE, SmallSensor

from planrunner.bench.simulation import ask
from planrunner.instruments.interfaces import InstrumentError

SPEED = 10.0
"""Seconds of the bench in one of the wall."""
PATIENCE = 240.0
"""Seconds of the wall in which a process must have ended, however busy the computer is: the wall that nothing may hang past."""
AMBIENT = 298.15
SITE = "{latitude: 40 deg, gravity: 9.8 m/s^2}"
TRUTH = f"""\
planrunner_bench: 1
name: truth
clock: virtual
seed: 5
site: {SITE}
instruments:
  table:
    driver: virtual_table
    axes:
      - {{name: outer, direction: up, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2}}
      - {{name: inner, direction: north, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2}}
  chamber: {{driver: virtual_chamber, lowest: -55 degC, highest: 85 degC, ramp: 60 K/min, ambient: 25 degC, lag: 2 s}}
  gyro:
"""
BENCH = f"""\
planrunner_bench: 1
name: small
simulation: {{bench: truth.yaml, control: "127.0.0.1:9870"}}
site: {SITE}
protection: {{hottest: 40 degC, silence: 15 s}}
safe_order: [table, chamber, gyro]
instruments:
  table:
    driver: acutrol
    address: TCPIP::127.0.0.1::9878::SOCKET
    timeout: TIMEOUT
    axes:
      - {{name: outer, direction: up, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2}}
      - {{name: inner, direction: north, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2}}
  chamber:
    driver: watlow_f4t
    address: TCPIP::127.0.0.1::5025::SOCKET
    timeout: TIMEOUT
    lowest: -55 degC
    highest: 85 degC
    ramp: 60 K/min
    ambient: 25 degC
    lag: 2 s
  gyro:
"""
PLAN = """\
planrunner: 1
title: Three short segments
bench: bench.yaml
sensor: SENSOR
defaults:
  temperature: 25 degC
  orientation: {x: up, y: north, z: west}
  settle: 10 s
  dwell: 20 s
  watch: {lost_frames: 30 %, corrupt_frames: 30 %}
segments:
  - {label: still}
  - {label: turning, rate: 10 deg/s}
  - {label: warm, orientation: {x: up, y: east, z: north}, temperature: 28 degC}
estimates: {}
report: []
"""
LABELS = ("still", "turning", "warm")
DWELL, RATE = 20.0, 100.0


@dataclass
class SmallBench:
    """A running simulated bench in `folder`, with its plan beside it."""

    folder: Path
    process: subprocess.Popen[str]
    control: str
    token: str
    forks: Forks
    sensor: SmallSensor = FLEXURE
    runs: int = 0

    @classmethod
    def start(cls, folder: Path, timeout: str = "2 s", sensor: SmallSensor = FLEXURE) -> SmallBench:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "truth.yaml").write_text(TRUTH + sensor.truth, encoding="utf-8")
        (folder / "asked.yaml").write_text(BENCH.replace("TIMEOUT", timeout) + sensor.bench, encoding="utf-8")
        (folder / "plan.yaml").write_text(PLAN.replace("SENSOR", sensor.plan), encoding="utf-8")
        process, control, token = _served(folder, "asked.yaml", "--copy", str(folder / "bench.yaml"))
        return cls(folder, process, control, token, Forks(ENVIRONMENT), sensor)

    def start_again(self) -> None:
        """At the same addresses, after its process was killed."""
        self.process, self.control, self.token = _served(self.folder, "bench.yaml")

    def stop(self) -> None:
        self.forks.close()
        self.process.terminate()
        try:
            self.process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise

    def inject(self, fault: str) -> int:
        return int(ask(self.control, {"inject": fault}, self.token)["fault"])

    def clear(self) -> None:
        """End all faults, and wait until their ports are back."""
        ask(self.control, {"clear": "all"}, self.token)
        until(lambda: not self.state()["faults"], "the faults are cleared")
        for address in ask(self.control, {"ask": "bench"})["addresses"].values():
            if "/" in address:
                until(Path(address).exists, f"{address} is back")

    def state(self) -> dict[str, Any]:
        """What is true of the instruments."""
        for _ in range(3):
            try:
                return ask(self.control, {"ask": "state"})
            except InstrumentError:  # a busy computer
                time.sleep(1)
        return ask(self.control, {"ask": "state"})

    def planrunner(self, *arguments: str, environment: Mapping[str, str] | None = None) -> Run:
        """A process of planrunner in the bench's folder."""
        self.runs += 1
        return self.forks.start([*arguments], self.folder, self.folder / f"said-{self.runs}.txt", environment or {})


ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def until(condition: Callable[[], bool], what: str, patience: float = PATIENCE, pause: float = 0.05) -> None:
    """Wait for it. Raises `AssertionError` past the wall."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, f"not within {patience:g} s: {what}"
        time.sleep(pause)


def _served(folder: Path, bench: str, *more: str) -> tuple[subprocess.Popen[str], str, str]:
    ready = folder / "ready.json"
    ready.unlink(missing_ok=True)
    command = [sys.executable, "-m", "planrunner", "simulate-bench", bench, "--speed", str(SPEED)]
    with (folder / "simulated.log").open("a") as log:
        process = subprocess.Popen(
            [*command, "--ready", str(ready), *more],
            cwd=folder,
            env=ENVIRONMENT,
            text=True,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    until(lambda: ready.exists() or process.poll() is not None, "the simulated bench is ready")
    assert process.poll() is None, (folder / "simulated.log").read_text(encoding="utf-8")
    note = json.loads(ready.read_text(encoding="utf-8"))
    return process, str(note["control"]), str(note["token"])
