"""What a bench is kept to: limits that plans may not pass and that the instruments are told."""

from __future__ import annotations

import math

import pytest

from planrunner.bench.model import Bench, models, parse_bench, read_bench
from planrunner.bench.protection import own_limits
from planrunner.instruments.interfaces import OwnLimits
from planrunner.plan import source


def virtual(more: str = "") -> tuple[Bench, list[str]]:
    _, data, _ = read_bench("virtual")
    bench, log = parse_bench(source.parse(data.decode() + more, "lab.yaml"))
    assert bench is not None
    return bench, [finding.code for finding in log.errors]


def test_without_protection_the_instruments_say_what_they_can_do() -> None:
    bench, errors = virtual()
    assert not errors and own_limits(bench.protection) == OwnLimits(silence=60.0)
    table = models(bench).table
    assert table is not None and max(axis.max_rate for axis in table.axes) > math.radians(300)


def test_limits_in_si_and_what_plans_may_use() -> None:
    bench, errors = virtual(
        "protection: {rate: 90 deg/s, acceleration: 18 deg/s^2, position_error: 1.8 deg, "
        "coldest: -40 degC, hottest: 500 degC, silence: 10 s}\n"
    )
    assert not errors
    limits = own_limits(bench.protection)
    assert limits.rate == pytest.approx(math.pi / 2) and limits.acceleration == pytest.approx(math.pi / 10)
    assert limits.position_error == pytest.approx(math.pi / 100)
    assert limits.coldest == pytest.approx(233.15) and limits.silence == 10.0
    found = models(bench)
    assert found.table is not None and found.chamber is not None
    assert all(axis.max_rate <= math.pi / 2 + 1e-12 for axis in found.table.axes)
    assert all(axis.max_acceleration <= math.pi / 10 + 1e-12 for axis in found.table.axes)
    assert found.chamber.lowest == pytest.approx(233.15)
    assert found.chamber.highest < 400  # what the chamber reaches, not what is allowed beyond it


@pytest.mark.parametrize(
    "more",
    [
        "protection: {silence: 4 s}\n",
        "protection: {silence: 2 h}\n",
        "protection: {coldest: 20 degC, hottest: 10 degC}\n",
        "protection: {rate: -5 deg/s}\n",
    ],
)
def test_protection_that_makes_no_sense(more: str) -> None:
    assert virtual(more)[1] == ["meaning-range"]
