"""Sensors as a bench file describes them."""

from __future__ import annotations

from typing import Any

from planrunner.bench.model import Bench, models, parse_bench
from planrunner.instruments.models import SensorModel
from planrunner.plan import source

HEAD = """planrunner_bench: 1
name: serial
clock: wall
site: {latitude: 40 deg, gravity: 9.80665 m/s^2}
instruments:
  imu:
    port: PORT
"""


def bench_of(keys: str, port: str = "/dev/ttyUSB0") -> Bench:
    """keys: of the sensor, one a line."""
    lines = "".join(f"    {line.strip()}\n" if line.strip() else "" for line in keys.split(";"))
    bench, log = parse_bench(source.parse(HEAD.replace("PORT", port) + lines, "bench.yaml"))
    assert bench is not None and not log.errors, [str(finding) for finding in log]
    return bench


def parameters_of(keys: str, port: str = "/dev/ttyUSB0") -> Any:
    return bench_of(keys, port).instruments["imu"].parameters


def model_of(keys: str) -> SensorModel:
    model = models(bench_of(keys)).sensor
    assert model is not None
    return model


def findings_of(keys: str) -> list[str]:
    """What is wrong with a sensor's keys."""
    lines = "".join(f"    {line.strip()}\n" for line in keys.split(";"))
    _, log = parse_bench(source.parse(HEAD + lines, "bench.yaml"))
    return [str(finding) for finding in log.errors]
