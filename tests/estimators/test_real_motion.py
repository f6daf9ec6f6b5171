"""Real recordings of motion that nobody commanded: an array of IMUs twisted by hand, and a gyro on a stepper with an encoder."""

from __future__ import annotations

import math

import numpy as np
from recorded import from_samples, real

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.error_model.estimator import ErrorModelEstimator
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.interface import EstimateRequest
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.schedule import RecordedMotion, Segment

FRAME, BEGIN = 106, 4  # bytes
UNITS = {
    f"{kind}_{unit}_{axis}": text
    for unit in (0, 2)
    for kind, text in (("accel", "g"), ("gyro", "deg/s"))
    for axis in "xyz"
}


def twisted() -> list[RecordedSegment]:
    """Units 0 and 2 of the array: seven segments of slow turns, three of twists."""
    raw = np.fromfile(real("imu_array", "exp_2.bin"), np.uint8)[BEGIN:]
    frames = raw[: len(raw) // FRAME * FRAME].reshape(-1, FRAME)
    words = frames[:, 8:104].copy().view(">i2").reshape(-1, 8, 2, 3).astype(float)
    clock = np.unwrap(frames[:, 4:8].copy().view(">u4").ravel().astype(float), period=2.0**32) / 64e6
    time = clock - clock[0]
    scales = {"accel": 2048.0, "gyro": 16.4}
    channels = {
        f"{kind}_{unit}_{axis}": words[:, unit, k, a] / scales[kind]
        for unit in (0, 2)
        for k, kind in enumerate(scales)
        for a, axis in enumerate("xyz")
    }
    reference = RecordedMotion(rates=tuple(f"gyro_0_{a}" for a in "xyz"), forces=tuple(f"accel_0_{a}" for a in "xyz"))
    spans = [(30 + 24 * k, 54 + 24 * k) for k in range(1, 8)] + [(515 + 10 * k, 525 + 10 * k) for k in range(1, 4)]
    found = []
    for number, (low, high) in enumerate(spans):
        rows = (time >= low) & (time < high)
        planned = Segment(number, f"part_{number}", None, "unknown", reference, None)
        found.append(from_samples(planned, time[rows], {n: v[rows] for n, v in channels.items()}, UNITS))
    return found


def test_the_lever_arm_between_two_units_of_an_array() -> None:
    """The chips sit on a grid of some centimetres; unit 2 is the neighbour of unit 0 along −y, as the three axes agree."""
    full, noise = {"g": 16.0, "deg/s": 1998.0}, {"g": 0.004, "deg/s": 0.1}
    outputs = (OutputModel(n, u, full[u], NoiseModel(white=noise[u] / math.sqrt(62.5))) for n, u in UNITS.items())
    sensor = SensorModel("imu", tuple(outputs), 62.5)
    effects = ("accel_bias", "accel_scale_factor", "accel_misalignment", "lever_arm")
    parameters = ErrorModelParameters(outputs={"accel_2_x": effects, "accel_2_y": effects})
    request = EstimateRequest("array", tuple(twisted()), parameters, Site(math.radians(59.0), 9.818), sensor)
    found = ErrorModelEstimator().estimate(request)
    for output in ("accel_2_x", "accel_2_y"):
        arm = [found[f"lever_arm_r_{axis}_{output}"].value for axis in "xyz"]
        assert np.abs(np.array(arm) - [0.0, -20.0, 0.0]).max() < 2.0
    assert abs(found["accel_scale_factor_x"].value) < 2e4


def test_a_gyro_on_a_stepper_with_an_encoder() -> None:
    """Known: −1.006 of the encoder's rate about z, and a delay of about a sample. The axis points down, so the sense is clockwise."""
    from scipy.io import loadmat

    data = loadmat(real("two_imus_encoder", "raw_yaw_slow.mat"))
    time, angle, gyro = (data[name].ravel().astype(float) for name in ("all_time", "all_encoder", "all_gyro_2_z"))
    later = np.append(True, np.diff(np.maximum.accumulate(time)) > 1e-3)
    time, angle, gyro = time[later], angle[later], gyro[later]
    motion = RecordedMotion(angle="encoder", about=(0.0, 0.0, -1.0), averaging=0.2)
    units, attitude = {"gyro_z": "deg/s", "encoder": "deg"}, np.eye(3)
    parts = []
    for number in range(6):
        rows = (time >= time[0] + 60 + 30 * number) & (time < time[0] + 90 + 30 * number)
        planned = Segment(number, f"part_{number}", attitude, "by the stepper", motion, None)
        parts.append(from_samples(planned, time[rows], {"gyro_z": gyro[rows], "encoder": angle[rows]}, units))
    sensor = SensorModel("imu", (OutputModel("gyro_z", "deg/s"), OutputModel("encoder", "deg")), 100.0)
    parameters = ErrorModelParameters(outputs={"gyro_z": ("gyro_bias", "gyro_scale_factor")})
    found = ErrorModelEstimator().estimate(
        EstimateRequest("gyro", tuple(parts), parameters, Site(math.radians(40.0)), sensor)
    )
    assert abs(found["gyro_scale_factor_z"].value - 6e3) < 3e3
