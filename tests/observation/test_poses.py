"""Sensors in unknown orientations: directions, what has a signature and what has none, and bad input."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.error_model.effects.table import TableTilt
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.gap.hypotheses.candidates import FULL
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.refusals import ObservationError
from planrunner.observation.samples import directions_of, poses, unknown_orientations
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Motion, Rest, Segment, Spin

G = 9.80665
NAMES = ("accel_x", "accel_y", "accel_z")
SIGMA = np.array([0.04, 0.04, 0.07])  # m/s² per sample
SENSOR = SensorModel(
    "imu",
    tuple(
        OutputModel(name, "m/s^2", noise=NoiseModel(sigma / 10, 0.0, 0.0))
        for name, sigma in zip(NAMES, SIGMA, strict=True)
    ),
    100.0,
)
SITE = Site(0.7, G)
STILL = Rest()


def tumbled(
    matrix: np.ndarray,
    bias: np.ndarray,
    count: int = 24,
    seed: int = 1,
    names: Sequence[str] = NAMES,
    motion: Motion = STILL,
) -> list[RecordedSegment]:
    """Poses of 4 s in random orientations: readings = bias + matrix·f + noise."""
    draw = np.random.default_rng(seed)
    up = Rotation.random(count, random_state=seed).as_matrix()[:, :, 2]
    made = []
    for n, direction in enumerate(up):
        samples = bias + matrix @ (G * direction) + draw.normal(0, SIGMA, (400, 3))
        columns = dict(zip(names, samples.T, strict=False))
        time = 10.0 * n + np.arange(400) / 100

        def blocks(
            wanted: Sequence[str], time: np.ndarray = time, columns: dict[str, np.ndarray] = columns
        ) -> Iterator[Block]:
            yield Block(time, {name: columns[name] for name in wanted})

        segment = Segment(n, f"pose {n}", None, "unknown", motion, None)
        made.append(
            RecordedSegment(segment, dict.fromkeys(names, "m/s^2"), statistics_of(blocks(names), names, 400), blocks)
        )
    return made


SKEWED = np.array([[1.004, 0.002, 0.0], [0.001, 0.997, -0.004], [0.003, 0.0, 1.007]])
BIAS = np.array([0.10, -0.2, 0.35])


def test_directions_are_those_of_gravity() -> None:
    """With the whole model fitted, up to the rotation of the triad that nobody can see; with none of it, up to bias and scale."""
    up = Rotation.random(24, random_state=1).as_matrix()[:, :, 2]
    readings = BIAS + G * up @ SKEWED.T
    symmetric = (SKEWED + SKEWED.T) / 2
    found = directions_of(BIAS + G * up @ symmetric.T, G, FULL)
    assert found == pytest.approx(up, abs=1e-5)
    raw = directions_of(readings, G, ())
    assert raw == pytest.approx(readings / np.linalg.norm(readings, axis=1)[:, None])


def test_scale_and_the_sums_of_opposite_misalignments_are_reported() -> None:
    observed = poses(tumbled(SKEWED, BIAS), SITE, SENSOR, ("accel_bias",))
    assert len(observed.channels) == 1
    found = diagnose(observed, DiagnosisOptions(nominal=("accel_bias",)))
    assert found.verdict.effects == ("accel_misalignment", "accel_scale_factor")
    told = {p.name: (p.value, p.standard_uncertainty) for p in found.parameters}
    for name, expected in {"k_x": 4000, "k_y": -3000, "k_z": 7000}.items():
        assert told[name][0] == pytest.approx(expected, abs=4 * told[name][1])
    for name, angle in {"gamma_xy": 0.003, "gamma_xz": 0.003, "gamma_yz": -0.004}.items():
        value, u = told[name]
        assert np.radians(value / 3600) == pytest.approx(angle, abs=4 * np.radians(u / 3600))


def test_a_whole_model_leaves_nothing_and_a_turned_triad_is_not_seen() -> None:
    turned = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
    for matrix, nominal in ((SKEWED, FULL), (turned, ())):
        bias = BIAS if nominal else np.zeros(3)
        observed = poses(tumbled(matrix, bias, seed=4), SITE, SENSOR, nominal)
        assert diagnose(observed, DiagnosisOptions(nominal=nominal)).verdict.kind == "none"


def test_a_tilt_has_no_signature_at_all() -> None:
    observed = poses(tumbled(np.eye(3), np.zeros(3)), SITE, SENSOR, ())
    (variant,) = TableTilt().variants(observed)
    assert all(not column.parts[0].any() for column in variant.columns)


def test_poses_have_noise_alike() -> None:
    """z is noisier than x: a pose along z is scaled down to the mean level."""
    observed = poses(tumbled(np.eye(3), np.zeros(3)), SITE, SENSOR, ())
    scatter = [observed.values[part, 0].std() for part in observed.segments()]
    assert scatter == pytest.approx([np.mean(scatter)] * len(scatter), rel=0.12)
    assert observed.channels[0].white * 10 == pytest.approx(np.mean(scatter), rel=0.02)


def test_bad_input_is_refused() -> None:
    known = tumbled(np.eye(3), np.zeros(3), 3)
    assert unknown_orientations(known)
    seen = dataclasses.replace(known[1], segment=dataclasses.replace(known[1].segment, attitude=np.eye(3)))
    with pytest.raises(
        ObservationError,
        match="the orientation of segment 'pose 0' is unknown, but other segments have known orientations",
    ):
        unknown_orientations([known[0], seen])
    with pytest.raises(ObservationError, match="moves in an unknown orientation"):
        unknown_orientations(tumbled(np.eye(3), np.zeros(3), 3, motion=Spin(0.1)))
    with pytest.raises(ObservationError, match=r"only 2 accelerometers are recorded"):
        poses(tumbled(np.eye(3), np.zeros(3), names=NAMES[:2]), SITE, SENSOR, ())
    with pytest.raises(ObservationError, match=r"not close to a sphere of radius g .the median of their lengths is"):
        poses(tumbled(np.eye(3) / 50, np.zeros(3)), SITE, SENSOR, FULL)
