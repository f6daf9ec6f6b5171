"""What a bench declares of a played-back recording: units, noise in three forms, power-on; and a whole laboratory recording."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import models, read_bench, site_of
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.physics.earth import Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.tasks.check import check_plan
from tests.recorded_imu import rows, write_recording

PLAN = Path(__file__).parents[2] / "plans" / "imu_recorded_over_temperature.yaml"


def read(channel: str, **changes: str) -> tuple[RecordingParameters, list[str]]:
    keys = {
        "file": "r.csv",
        "kind": "imu",
        "time": "{column: t}",
        "sample_rate": "50 Hz",
        "channels": f"{{x: {{column: x, {channel}}}}}",
        **changes,
    }
    log = Findings()
    text = "\n".join(f"{name}: {value}" for name, value in keys.items())
    made = RecordOf(RecordingParameters).read(source.parse(text, "bench.yaml"), log)
    return made, [finding.code for finding in log]


# One sample at 50 Hz scatters by 0.01 deg/s in all three: 0.002·√25, and 0.0014142·√50.
@pytest.mark.parametrize(
    "said", ["noise: 0.01 deg/s", "noise_density: 0.002 deg/s/sqrt(Hz)", "random_walk: 0.08485281374 deg/sqrt(h)"]
)
def test_white_noise_may_be_given_in_three_forms(said):
    made, found = read(f"unit: deg/s, {said}")
    assert found == []
    noise = RecordingPlayer.model(made).outputs[0].noise
    assert noise.white * math.sqrt(50) == pytest.approx(0.01, rel=1e-9)


def test_flicker_and_resolution_are_declared_in_any_unit_of_the_dimension():
    made, found = read("unit: m/s^2, noise_density: 50 ug/sqrt(Hz), bias_instability: 10 ug, resolution: 20 ug")
    assert found == []
    noise = RecordingPlayer.model(made).outputs[0].noise
    assert noise.white * math.sqrt(50) == pytest.approx(250e-6 * 9.80665)
    assert noise.bias_instability == pytest.approx(1e-5 * 9.80665)
    assert noise.resolution == pytest.approx(2e-5 * 9.80665)


@pytest.mark.parametrize(
    ("said", "code"),
    [
        ("noise: 0.01 deg/s, noise_density: 0.002 deg/s/sqrt(Hz)", "meaning-noise-twice"),
        ("noise_density: 0.002 deg/s", "meaning-dimension"),
        ("random_walk: 0.1 deg/h", "meaning-dimension"),
        ("resolution: 20 ug", "meaning-dimension"),
        ("noise_density: -0.002 deg/s/sqrt(Hz)", "meaning-range"),
    ],
)
def test_noise_that_does_not_fit_is_found(said, code):
    assert read(f"unit: deg/s, {said}")[1] == [code]


def connect(folder: Path, time: str) -> RecordingPlayer:
    (folder / "r.csv").write_text("t,x\n12,1\n12.02,2\n12.04,3\n", encoding="utf-8")
    made, _ = read("unit: deg/s", time=time)
    player = RecordingPlayer.connect(made, Surroundings(VirtualClock(), Site(0.7), data_root=folder))
    assert isinstance(player, RecordingPlayer)
    return player


@pytest.mark.parametrize(("time", "first"), [("{column: t}", 0.0), ("{column: t, power_on: 2 s}", 10.0)])
def test_time_counts_from_power_on_where_it_is_declared(tmp_path, time, first):
    from planrunner.plan.schedule import Rest, Segment

    player = connect(tmp_path, time)
    block = next(iter(player.stream(Segment(0, "all", None, "unknown", Rest(), None))))
    assert block.time.tolist() == pytest.approx([first, first + 0.02, first + 0.04])


def test_power_on_after_the_first_row_is_an_error(tmp_path):
    with pytest.raises(InstrumentError, match="begins at 12 s, before the power-on at 20 s"):
        connect(tmp_path, "{column: t, power_on: 20 s}")


def test_the_magnetic_field_of_a_site_reaches_its_model():
    bench, _, _ = read_bench("imu_recording")
    assert site_of(bench).magnetic_field == (0.0, 0.55, -0.83)
    other, _, _ = read_bench("virtual")
    assert site_of(other).magnetic_field is None


def test_a_laboratory_recording_is_played_back_segment_by_segment(tmp_path):
    """Labels, order, dwells, rates and temperatures of plan and table agree; samples come in declared units, since power-on."""
    sound = check_plan(PLAN).sound()
    write_recording(tmp_path, noise=0.0)
    listed = rows()
    assert [segment.label for segment in sound.schedule.segments] == [row.label for row in listed]
    parameters = sound.bench.instruments["imu"].parameters
    assert isinstance(parameters, RecordingParameters)
    player = RecordingPlayer.connect(
        parameters, Surroundings(VirtualClock(), models(sound.bench).site, data_root=tmp_path)
    )
    player.foresee(sound.schedule.segments)
    total = 0
    for segment, row in zip(sound.schedule.segments, listed, strict=True):
        assert segment.dwell == pytest.approx(row.seconds)
        assert math.degrees(segment.rate) == pytest.approx(row.rate)
        held = segment.temperature if segment.ramp_to is None else segment.ramp_to
        assert held == pytest.approx(row.celsius + 273.15)
        blocks = list(player.stream(segment))
        assert blocks[0].time[0] == pytest.approx(row.start)
        total += sum(block.time.size for block in blocks)
        if row.rate:
            along = "xyz"["RxRyRz".index(row.label[:2]) // 2]
            spun = np.concatenate([block.channels[f"gyro_{along}"] for block in blocks])
            assert spun.mean() == pytest.approx(row.rate, rel=0.01, abs=0.2)
            turned = blocks[-1].channels["table_angle"][-1] - blocks[0].channels["table_angle"][0]
            assert turned == pytest.approx(row.rate * (row.seconds - 0.02))
    assert total == 115_200
