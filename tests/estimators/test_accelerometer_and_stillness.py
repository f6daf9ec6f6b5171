"""The accelerometer triad against chosen truths, and still spans against a recording made by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_means, from_samples, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.gravity_magnitude import NAMES, fit_magnitude
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.interface import DesignRequest, EstimateRequest, EstimationError
from planrunner.estimators.method import designed
from planrunner.observation.still_detection import still_spans
from planrunner.physics.earth import Site
from planrunner.plan.orientation import rotation
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.selection import Detection

SITE = Site(math.radians(40.0), 9.80)
CHANNELS = ("accel_x", "accel_y", "accel_z")
BIAS = np.array([0.05, -0.03, 0.10])
RESPONSE = np.array([[1.002, 0.003, -0.001], [0.002, 0.997, 0.004], [-0.005, 0.001, 1.010]])


def attitudes(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    found = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(count)]
    return [matrix * np.sign(np.linalg.det(matrix)) for matrix in found]


def detection(window: str = "0.5 s", threshold: str = "0.05 m/s^2", at_least: str = "1 s") -> Detection:
    return Detection(
        detect="still",
        window=parse_quantity(window),
        threshold=parse_quantity(threshold),
        at_least=parse_quantity(at_least),
    )


def test_known_attitudes_recover_the_response() -> None:
    recorded = tuple(
        from_means(
            segment(f"A{n}", attitude),
            dict(zip(CHANNELS, (BIAS + RESPONSE @ (attitude @ [0, 0, 9.80])) / 9.80665, strict=True)),
            "g",
            1e-5,
        )
        for n, attitude in enumerate(attitudes(12))
    )
    parameters = AccelerometerMultiPositionParameters(uncertainty="within_segment")
    found = AccelerometerMultiPosition().estimate(
        EstimateRequest("a", recorded, parameters, SITE, sensor(*CHANNELS, unit="g"))
    )
    for axis, letter in enumerate("xyz"):
        length = np.linalg.norm(RESPONSE[axis])
        assert found[f"bias_{letter}"].value == pytest.approx(1e3 * BIAS[axis] / 9.80665, rel=1e-8)
        assert found[f"scale_{letter}"].value == pytest.approx(length, rel=1e-9)
        for other, name in enumerate("xyz"):
            if other != axis:
                value = 1e3 * RESPONSE[axis, other] / length
                assert found[f"misalignment_{letter}_{name}"].value == pytest.approx(value, rel=1e-7)


def test_scale_does_not_depend_on_an_unknown_first_angle() -> None:
    """37 stops about y whose first is 2.5° off level: the scale factors stay, the offset shows as misalignment of both axes."""
    recorded = []
    for n in range(37):
        angle = math.radians(10 * n)
        force = rotation(1, -(angle + math.radians(2.5))) @ [0, 0, 9.80]
        values = dict(zip(CHANNELS, np.array([0.97, 1.0, 1.02]) * force, strict=True))
        recorded.append(from_means(segment(f"P{n}", rotation(1, -angle)), values, "m/s^2", 1e-4))
    parameters = AccelerometerMultiPositionParameters(terms=("bias", "accel_x", "accel_z"))
    found = AccelerometerMultiPosition().estimate(
        EstimateRequest("a", tuple(recorded), parameters, SITE, sensor(*CHANNELS, unit="m/s^2"))
    )
    assert found["scale_x"].value == pytest.approx(0.97, rel=1e-9)
    assert found["scale_z"].value == pytest.approx(1.02, rel=1e-9)
    sine = 1e3 * math.sin(math.radians(2.5))
    assert abs(found["misalignment_x_z"].value) == pytest.approx(sine, rel=1e-9)
    assert found["misalignment_z_x"].value == pytest.approx(-found["misalignment_x_z"].value, rel=1e-9)


def test_magnitude_recovers_nine_parameters() -> None:
    """Readings from three skew axes with known angles between them."""
    scale, gamma = np.array([1.02, 0.98, 1.05]), np.radians([0.4, -0.7, 0.2])
    cosines = np.eye(3)
    for (i, j), angle in zip(((0, 1), (0, 2), (1, 2)), gamma, strict=True):
        cosines[i, j] = cosines[j, i] = math.cos(math.pi / 2 - angle)
    axes = np.linalg.cholesky(cosines)  # unit input axes, row by row, in some frame
    directions = np.array([matrix[:, 2] for matrix in attitudes(25)])
    found = fit_magnitude(BIAS + scale * ((directions * 9.80) @ axes.T), 9.80)
    assert dict(zip(NAMES, found.values, strict=True)) == pytest.approx(
        dict(zip(NAMES, [*BIAS, *scale, *gamma], strict=True)), rel=1e-9, abs=1e-12
    )
    assert np.abs(found.residuals).max() < 1e-12


@pytest.mark.slow
def test_magnitude_covariance_against_simulated_experiments() -> None:
    rng = np.random.default_rng(3)
    directions = np.array([matrix[:, 2] for matrix in attitudes(22, 4)])
    clean = BIAS + directions * 9.80
    sigma = 0.002
    draws = np.array([fit_magnitude(clean + rng.normal(0, sigma, clean.shape), 9.80).values for _ in range(1200)])
    jacobian = fit_magnitude(clean, 9.80).jacobian
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * sigma
    assert draws.std(axis=0) == pytest.approx(expected, rel=0.09)


def test_magnitude_refuses_what_it_cannot_determine() -> None:
    up = np.array([matrix[:, 2] for matrix in attitudes(22)])
    with pytest.raises(EstimationError, match="8 poses cannot determine 9"):
        fit_magnitude(up[:8] * 9.8, 9.8)
    flat = up.copy()
    flat[:, 2] = 0.0
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    with pytest.raises(EstimationError, match="poses"):
        fit_magnitude(flat * 9.8, 9.8)
    with pytest.raises(EstimationError, match="sphere"):
        fit_magnitude(up * 9.8 * np.linspace(0.02, 5, 22)[:, None], 9.8)


def made_by_hand(rows: int) -> tuple[RecordedSegment, list[tuple[float, float]]]:
    """100 Hz; still 0–5 s, turning 5–7 s, still 7–7.8 s (too short), turning 7.8–9 s, still 9–15 s; a missing sample at 12 s,
    which does not end the interval at rest."""
    time = np.arange(1500) / 100
    rng = np.random.default_rng(0)
    values = np.tile([0.0, 0.0, 9.8], (1500, 1)) + rng.normal(0, 0.01, (1500, 3))
    for low, high in ((5.0, 7.0), (7.8, 9.0)):
        inside = (time >= low) & (time < high)
        values[inside] += 3 * np.sin(2 * np.pi * (time[inside] - low))[:, None]
    values[1200, 1] = np.nan
    channels = {name: values[:, k] for k, name in enumerate(CHANNELS)}
    recorded = from_samples(segment("t"), time, channels, dict.fromkeys(CHANNELS, "m/s^2"), rows)
    return recorded, [(0.25, 4.75), (9.25, 14.75)]


def times(recorded: RecordedSegment) -> list[tuple[float, float]]:
    return [(one.span.start, one.span.end) for one in still_spans(recorded, detection())]


@pytest.mark.parametrize("rows", [1, 7, 100, 5000])
def test_still_spans_do_not_depend_on_blocks(rows: int) -> None:
    recorded, expected = made_by_hand(rows)
    spans = times(recorded)
    assert len(spans) == len(expected)
    assert np.abs(np.array(spans) - np.array(expected)).max() <= 0.03
    assert spans == times(made_by_hand(997)[0])


@pytest.mark.parametrize("as_rows", [True, False])
@pytest.mark.parametrize(("lost", "spans"), [(20, 1), (40, 2)])
def test_missing_numbers_count_like_missing_rows(as_rows: bool, lost: int, spans: int) -> None:
    """100 Hz, windows of half a second: 0.2 s of missing samples do not end an interval at rest, 0.4 s do. Single numbers are also
    missing in every tenth row, as in a log that another instrument shares."""
    time = np.arange(1000) / 100
    values = np.tile([0.0, 0.0, 9.8], (1000, 1)) + np.random.default_rng(0).normal(0, 0.01, (1000, 3))
    values[500 : 500 + lost] = np.nan
    values[3::10, 1] = np.nan
    kept = np.isfinite(values).all(axis=1) if as_rows else np.ones(1000, bool)
    channels = {name: values[kept, k] for k, name in enumerate(CHANNELS)}
    recorded = from_samples(segment("t"), time[kept], channels, dict.fromkeys(CHANNELS, "m/s^2"), 300)
    assert len(times(recorded)) == spans


def test_a_still_span_ends_where_the_sample_rate_changes_in_a_pause() -> None:
    """100 Hz in one pose, a pause, 50 Hz in another pose: no span contains both poses."""
    time = np.concatenate([np.arange(3000) / 100, 90 + np.arange(1500) / 50])
    values = np.random.default_rng(0).normal(0, 0.01, (4500, 3))
    values[:3000, 2] += 9.8
    values[3000:, 0] += 9.8
    channels = {name: values[:, k] for k, name in enumerate(CHANNELS)}
    first, second = still_spans(
        from_samples(segment("t"), time, channels, dict.fromkeys(CHANNELS, "m/s^2"), 700), detection()
    )
    assert first.span.end < 31 and second.span.start > 89
    np.testing.assert_allclose(first.mean, [0, 0, 9.8], atol=0.003)
    np.testing.assert_allclose(second.mean, [9.8, 0, 0], atol=0.003)


def test_span_statistics_equal_the_samples_own() -> None:
    recorded, _ = made_by_hand(64)
    first = still_spans(recorded, detection())[0]
    (block,) = list(made_by_hand(5000)[0].blocks(CHANNELS))
    inside = (block.time >= first.span.start) & (block.time < first.span.end - 1e-6)
    values = np.column_stack([block.channels[name][inside] for name in CHANNELS])
    assert first.count == inside.sum()
    assert first.mean == pytest.approx(values.mean(axis=0), rel=1e-12)
    assert first.standard_error == pytest.approx(0.01 / math.sqrt(first.count), rel=0.6)
    assert first.batches >= 8


def test_a_gap_is_not_still() -> None:
    time = np.concatenate([np.arange(300), np.arange(1000, 1300)]) / 100
    channels = dict.fromkeys(CHANNELS, np.ones(600))
    recorded = from_samples(segment("t"), time, channels, dict.fromkeys(CHANNELS, "g"))
    spans = times(recorded)
    assert len(spans) == 2
    assert spans[0][1] < 3.0
    assert spans[1][0] > 10.0


def test_still_detection_refusals() -> None:
    recorded, _ = made_by_hand(100)
    parameters = AccelerometerMultiPositionParameters(reference="gravity_magnitude")
    request = EstimateRequest(
        "a", (recorded,), parameters, SITE, sensor(*CHANNELS), detection=detection(threshold="1e-9 m/s^2")
    )
    with pytest.raises(EstimationError, match="no interval at rest was found"):
        AccelerometerMultiPosition().estimate(request)
    by_orientation = AccelerometerMultiPositionParameters()
    request = EstimateRequest("a", (recorded,), by_orientation, SITE, sensor(*CHANNELS), detection=detection())
    with pytest.raises(EstimationError, match="reference: gravity_magnitude"):
        AccelerometerMultiPosition().estimate(request)
    turned = from_samples(
        segment("t"), np.arange(300) / 100, dict.fromkeys(CHANNELS, np.ones(300)), dict.fromkeys(CHANNELS, "deg/s")
    )
    with pytest.raises(EstimationError, match="found from accelerations"):
        times(turned)


def test_design_of_known_and_unknown_attitudes() -> None:
    planned = tuple(segment(f"A{n}", attitude) for n, attitude in enumerate(attitudes(6)))
    model = sensor(*CHANNELS, unit="m/s^2")
    known = designed(
        AccelerometerMultiPosition(), DesignRequest("a", planned, AccelerometerMultiPositionParameters(), SITE, model)
    )
    assert known is not None
    assert known.blocks[2].terms == ("bias", "accel_x", "accel_y", "accel_z")
    unknown = AccelerometerMultiPositionParameters(reference="gravity_magnitude")
    unplanned = tuple(replace(one, attitude=None) for one in planned)
    for poses in (planned, unplanned):
        few = designed(AccelerometerMultiPosition(), DesignRequest("a", poses, unknown, SITE, model))
        assert few is not None
        assert [(one.code, one.error) for one in few.remarks] == [("physics-poses", True)]
