"""Which clock a bench runs on when its file does not say."""

from __future__ import annotations

import pytest

from planrunner.bench.clock import VirtualClock, WallClock
from planrunner.bench.model import read_bench
from planrunner.bench.opening import open_bench


@pytest.mark.parametrize(
    ("said", "expected"), [("", VirtualClock), ("clock: virtual\n", VirtualClock), ("clock: wall\n", WallClock)]
)
def test_a_recording_is_played_back_as_fast_as_it_can_unless_the_bench_says_otherwise(tmp_path, said, expected):
    (tmp_path / "r.csv").write_text("t,x\n0,1\n0.1,2\n0.2,3\n", encoding="utf-8")
    text = (
        "planrunner_bench: 1\nname: played\nsite: {latitude: 40 deg, gravity: 9.8 m/s^2}\n"
        + said
        + "instruments:\n  sensor: {driver: recording, file: r.csv, kind: imu, time: {column: t}, sample_rate: 10 Hz,"
        " channels: {x: {column: x, unit: deg/s}}}\n"
    )
    (tmp_path / "bench.yaml").write_text(text, encoding="utf-8")
    bench, _, _ = read_bench("bench.yaml", tmp_path)
    with open_bench(bench, data_root=tmp_path) as opened:
        assert type(opened.clock) is expected
