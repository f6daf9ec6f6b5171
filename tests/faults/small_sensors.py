"""The sensors that the small laboratory may have: how bench file and truth write them, and what they feel when it turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class SmallSensor:
    """truth, bench: the entries of the instrument `gyro`; plan: what the plan says of it. felt: channel → its value while the table turns
    at 10 deg/s, zero at rest; within: how far a sample may be from that."""

    truth: str
    bench: str
    plan: str
    felt: Mapping[str, float]
    within: float


FLEXURE = SmallSensor(
    truth="""\
    driver: virtual_flexure_gyro
    scale_factor: {x: 0.2 (deg/h)/(pulse/s), y: 0.2 (deg/h)/(pulse/s)}
    drift_x: {F: 1.8 deg/h, X: 3.2 deg/h/g, Y: -2.1 deg/h/g, Z: 0.35 deg/h/g}
    drift_y: {F: -1.2 deg/h, X: 2.4 deg/h/g, Y: 3.0 deg/h/g, Z: -0.28 deg/h/g}
    white_noise: 0.9 pulse/sqrt(s)
    full_scale: 1000000 pulse/s
    sample_rate: 100 Hz
""",
    bench="""\
    driver: declared_frame
    kind: flexure-gyro
    port: gyro
    baud: 115200
    sample_rate: 100 Hz
    silence: 10 s
    sync: "A5 5A"
    length: 15
    fields:
      torquer_x: {at: 2, type: i32, unit: pulse/s}
      torquer_y: {at: 6, type: i32, unit: pulse/s}
    counter: {at: 10, type: u16}
    status: {at: 12, bits: {overload: 4, self-test failed: 7}}
    checksum: {type: crc16_xmodem, from: 2}
""",
    plan="{kind: flexure-gyro, outputs: [torquer_x, torquer_y]}",
    felt={"torquer_x": 0.0, "torquer_y": 10 * 3600 / 0.2},
    within=0.002 * 10 * 3600 / 0.2,
)
"""pulse/s of the torquers that hold the gyro against the turning."""


def _inertial(driver: str, keys: str, turning: float) -> SmallSensor:
    """turning: 10 deg/s in the unit of its gyros."""
    bench = (
        f"    driver: {driver}\n    port: gyro\n    baud: 921600\n    sample_rate: 100 Hz\n    silence: 10 s\n{keys}"
    )
    truth = """\
    driver: virtual_imu
    kind: imu
    sample_rate: 100 Hz
    gyros: {full_scale: 300 deg/s, axes: {x: {bias: 1 deg/h}, y: {bias: 1 deg/h}, z: {bias: 1 deg/h}}}
    accelerometers: {full_scale: 5 g, axes: {x: {bias: 50 ug}, y: {bias: 50 ug}, z: {bias: 50 ug}}}
"""
    felt = {"gyro_x": turning, "gyro_y": 0.0, "gyro_z": 0.0}
    return SmallSensor(truth, bench, "{kind: imu, outputs: [gyro_x, gyro_y, gyro_z]}", felt, 0.002 * turning)


_IN_RADIANS = 0.17453292519943295
SENSORS = {
    "flexure": FLEXURE,
    "stim300": _inertial("stim300", "    datagram: 0xA7\n", 10.0),
    "kvh_1775": _inertial("kvh_1775", "    format: B\n", _IN_RADIANS),
    "xsens_mti": _inertial("xsens_mti", "    outputs: [rate, acceleration]\n", _IN_RADIANS),
    "vectornav": _inertial("vectornav", "    fields: [time_startup, imu]\n", _IN_RADIANS),
}
