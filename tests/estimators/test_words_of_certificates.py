"""Whatever a shipped estimator says is translated: descriptions of coefficients, notes, warnings, and its own name.

Small estimates of the other tests say it. Each text must have a template that every catalogue holds; nothing in it may stay English.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import entry_points

import numpy as np
import pytest
import rocking_recordings as rocking
import simulated_imu as imu
import test_accelerometer_and_stillness as accelerometers
import test_allan_recording as allan
import test_compensation_residual as compensation
import test_drift as drifting
import test_error_model as models
import test_fixture_angles as fixture
import test_flexure_gyro_static as flexure
import test_imu_multi_position as imu_calibration
import test_modulation_residual as modulation
import test_repeatability as repeats
import test_rocking_drift as drifts
import test_scale_factor as single_axis
import test_temperature_model as temperatures
import tilted_recording as tilted
from recorded import from_means, segment, sensor
from standing_unit import recorded, request, samples

from planrunner.archive.recording import RecordedSegment
from planrunner.base.said import Said
from planrunner.error_model.flexure_gyro import PRODUCTS
from planrunner.error_model.terms import error_model
from planrunner.estimators.accelerometer import by_magnitude as accelerometer_by_magnitude
from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.allan import allan_deviation
from planrunner.estimators.analysis import coarse_counts, lost_samples
from planrunner.estimators.declared_axes import AxisResponse, against_nominal, contradictions
from planrunner.estimators.flexure_gyro.flexure_gyro_static import descriptions
from planrunner.estimators.imu.coefficients import Response, calibration
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.estimators.rocking.statistics import StateDrifts, implausible
from planrunner.estimators.strapdown.strapdown_navigation import StrapdownNavigation
from planrunner.instruments.models import NoiseModel
from planrunner.plan.units import unit
from planrunner.reporting.certificate_names import of_estimator
from planrunner.reporting.language import languages, spoken, translations
from tests.worlds.campaigns import CAMPAIGNS, Campaign
from tests.worlds.coverage import recorded as recorded_in_world
from tests.worlds.faults import WORLDS

TRIAD = fixture.STATED
GYROS = fixture.GYROS


def said_by_flexure_gyros() -> Iterator[Estimate | Said]:
    zero, three = np.zeros((8, 2)), np.array([[0.1, -0.2], [0.05, 0.3], [-0.4, 0.15]])
    drift = compensation.calibrated("drift", compensation.OPTIMAL, zero)
    yield drift
    yield from descriptions(tuple(PRODUCTS))
    other = compensation.calibrated("traditional", compensation.TRADITIONAL, zero)
    yield compensation.compare({"drift": drift, "traditional": other}, three)


def said_of_scale_factors() -> Iterator[Estimate | Said]:
    rates = np.array([-100.0, -50.0, 0.0, 50.0, 100.0])
    yield single_axis.line(rates, 2 * rates + np.array([0.1, 0, -0.1, 0, 0.2]))
    for celsius in ((-40.0, 20.0, 60.0), (None,)):
        runs = [tilted.series(TRIAD, GYROS, one, repeat=n) for one in celsius for n in (1, 2)]
        yield tilted.estimate([one for run in runs for one in run], TRIAD)
    yield fixture.found(fixture.spins([fixture.Z_UP, fixture.X_UP, fixture.Y_UP]))


def said_of_navigation() -> Iterator[Estimate | Said]:
    yield StrapdownNavigation().estimate(
        request(recorded("align", samples(600), 0.0), recorded("go", samples(600), 600.0))
    )
    used = modulation.navigated("still", 0.5), modulation.navigated("turned", 0.1)
    yield modulation.ModulationResidual().estimate(modulation.request(*used))


def said_of_rocking() -> Iterator[Estimate | Said]:
    yield rocking.estimate(drifts.both())


def said_of_triads() -> Iterator[Estimate | Said]:
    truth = imu.drawn_truth(np.random.default_rng(1))
    yield imu_calibration.calibrate(imu.recorded(imu.plan(), truth))
    yield imu_calibration.calibrate(
        imu.recorded(imu.plan(), truth), **imu_calibration.BOTH, misalignment="lower_triangular"
    )
    for kind, text, terms in (
        ("gyro", "rad/s", ("bias", "rate_x", "rate_y", "accel_x_accel_z", "accel_y_accel_z")),
        ("accel", "m/s^2", ("bias", "accel_x", "accel_y", "accel_z", "rate_x", "rate_y", "rate_z")),
    ):
        response = Response(kind, (unit(text),) * 3, error_model(terms), np.ones((3, len(terms))))
        yield from (one.description for one in calibration([response], lower_triangular=False).quantities)
    names = accelerometers.CHANNELS
    for chosen in (("bias", "accel_x", "accel_y", "accel_z"), ("bias", "accel_x", "accel_z")):
        known = [
            from_means(segment(f"A{n}", one), dict(zip(names, one @ [0.1, 0.2, 9.8], strict=True)), "m/s^2", 1e-4)
            for n, one in enumerate(accelerometers.attitudes(12))
        ]
        parameters = AccelerometerMultiPositionParameters(terms=chosen)
        model = sensor(*names, unit="m/s^2")
        yield AccelerometerMultiPosition().estimate(
            EstimateRequest("a", tuple(known), parameters, accelerometers.SITE, model)
        )
    yield from accelerometer_by_magnitude.DESCRIPTIONS


def said_of_error_models() -> Iterator[Estimate | Said]:
    outputs = {"gx": ("gyro_bias", "gyro_scale_factor", "site_latitude")}
    yield models.estimate(imu.recorded(imu.plan(), imu.drawn_truth(np.random.default_rng(1))), outputs)
    turning = [
        from_means(imu.spin("z", rate), {"gz": 40.0 * rate}, "pulse/s", 0.1, start=100.0 * place)
        for place, rate in enumerate((10.0, -10.0, 50.0, -50.0))
    ]
    yield models.estimate(turning, {"gz": ("gyro_bias", "gyro_scale_factor")})


def said_of_noise() -> Iterator[Estimate | Said]:
    yield allan.run(allan.record(allan.white(4000)))
    yield from allan_deviation.WORDS.values()


def said_over_temperature() -> Iterator[Estimate | Said]:
    celsius = [-40.0, 0.0, 25.0, 60.0]
    for form in ("polynomial", "spline"):
        yield temperatures.model(temperatures.given(celsius, [1.0, 2.1, 2.9, 4.2]), form=form, order=1)
    up, down = temperatures.ramp("up", -20, 60, np.sin, 1), temperatures.ramp("down", 60, -20, np.cos, 2)
    yield temperatures.model(recorded=(up, down), channels=("gyro",), temperature_channel="inside", order=1)


def said_of_repeats() -> Iterator[Estimate | Said]:
    yield repeats.of_values({"r1": 998, "r2": 1000, "r3": 1005})
    yield repeats.of_values({"a1": 1, "a2": 3, "b1": 6, "b2": 8}, groups={"a": ("a*",), "b": ("b*",)})


def drifting_line(campaign: Campaign) -> Estimate:
    world = WORLDS["linear drift"]
    _, made = recorded_in_world(campaign, world, np.random.default_rng(1))
    return drifting.found(campaign, world, made)


def said_of_drifts() -> Iterator[Estimate | Said]:
    yield drifting_line(drifting.asking("scale_factor", "linear"))


SAYING: tuple[Callable[[], Iterator[Estimate | Said]], ...] = (
    said_by_flexure_gyros, said_of_scale_factors, said_of_navigation, said_of_rocking, said_of_triads, said_of_error_models,
    said_of_noise,
    said_over_temperature, said_of_repeats, said_of_drifts,
)  # fmt: skip


@pytest.fixture(scope="module")
def heard() -> tuple[set[str], list[Said]]:
    """The estimators that spoke, and what they said."""
    spoke: set[str] = set()
    texts: list[Said] = []
    for saying in SAYING:
        for item in saying():
            if isinstance(item, Said):
                texts.append(item)
            else:
                spoke.add(item.estimator)
                texts += [*(one.description for one in item.coefficients), *item.notes, *item.warnings]
    return spoke, texts


def templates_of(text: Said) -> Iterator[str]:
    """The templates of a text and of the texts in it."""
    yield text.template
    for value in text.values.values():
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, Said):
                yield from templates_of(part)


def untranslated(texts: Iterable[Said], language: str) -> set[str]:
    """Templates that have words and are not in the catalogue, and texts without a template."""
    known = translations(language)
    found = {template for text in texts for template in templates_of(text)} - set(known)
    return {template for template in found if not template or re.search("[A-Za-z]", PLACE.sub("", template))}


PLACE = re.compile(r"\{[^}]*\}")


@pytest.mark.parametrize("language", languages())
def test_everything_said_is_translated(heard: tuple[set[str], list[Said]], language: str) -> None:
    spoke, texts = heard
    assert spoke == {
        entry.name for entry in entry_points(group="planrunner.estimators") if "planrunner." in entry.value
    }
    assert len(set(texts)) > 150
    assert not untranslated(texts, language), "run `make catalogues` and translate"
    term = spoken(language)["term"]
    assert all(term(of_estimator(name)) != name for name in spoke)
    assert all(term(text) != text for text in texts)


def series(*left_out: str) -> list[RecordedSegment]:
    """Two repeats of rates, the first without what the names end with."""
    first, second = (tilted.series(TRIAD, GYROS, repeat=n) for n in (1, 2))
    return [*(one for one in first if not one.label.endswith(left_out)), *second]


def a_cut_series() -> tuple[Said, ...]:
    first, *rest = series()
    return tilted.estimate([replace(first, truncated=True), *rest], TRIAD).warnings


def a_dead_zone() -> tuple[Said, ...]:
    still = [
        tilted.sampled(one.segment, {"gyro_x": 0.0 if abs(one.segment.rate) < 0.1 else math.degrees(one.segment.rate)})
        for one in tilted.series({"x": (0.0, 0.0)}, {"x": GYROS["x"]}, rates=(100.0, -100.0, 2.0, -2.0, 1.0, -1.0))
    ]
    return tilted.estimate(still, {"x": (0.0, 0.0)}).warnings


def a_rocking_test(without: str = "", axes: int = 3) -> tuple[Said, ...]:
    found = rocking.recordings([("vertical", drifts.quadruple())])
    table = replace(drifts.TABLE, axes=drifts.TABLE.axes[:axes]) if axes else None
    return rocking.estimate(
        drifts.without(found, without) if without else found, "{azimuth: nominal}", Setup(table)
    ).warnings


def platform_drifts(*columns: float) -> list[Said]:
    """Runs whose drifts [deg/h] these are about x and z by accelerometers, and by gimbals."""
    scatter = 0.01 * np.random.default_rng(1).standard_normal((3, 4, 4))
    return list(implausible([StateDrifts("vertical", (0, 2), (), np.array(columns) + scatter)], 15.0, 0.01))


def lost(count: int) -> tuple[Said, ...]:
    one = from_means(segment("R1"), {"gyro": 1.0}, "deg/h", 0.1)
    return lost_samples([replace(one, statistics=replace(one.statistics, rejected=3, largest_gap=5.0))] * count, 100.0)


def rounded() -> tuple[Said, ...]:
    device = sensor("gyro", unit="pulse/s", noise=NoiseModel(resolution=50.0))
    return coarse_counts([from_means(segment("R1"), {"gyro": 1.0}, "pulse/s", 0.1)], [], device)


def responding(*rows: Sequence[float], text: str = "g", kind: str = "accel") -> list[Said]:
    """Of a triad with these ratios along x, y and z."""
    return contradictions(
        [AxisResponse(f"{kind}_{'xyz'[k]}", k, unit(text), dict(enumerate(row))) for k, row in enumerate(rows)]
    )


LOUD = np.random.default_rng(3).normal(0, 0.5, (8, 2))
WARNED: dict[str, Callable[[], Sequence[Said]]] = {
    "scatter beyond the noise": lambda: flexure.estimate(LOUD, error=0.01, uncertainty="within_segment").warnings,
    "scatter, which the basis has": lambda: flexure.estimate(LOUD, error=0.01).warnings,
    "outputs that scatter otherwise": lambda: flexure.estimate(LOUD * [1.0, 100.0], error=0.01).warnings,
    "noise beyond the model": lambda: (
        allan.run(allan.record(allan.white(4000) + 50 * np.sin(np.arange(4000) / 40))).warnings
    ),
    "counts": rounded,
    "no start zero": lambda: tilted.estimate(series("start-zero"), TRIAD).warnings,
    "no end zero": lambda: tilted.estimate(series("end-zero"), TRIAD).warnings,
    "fewer rates": lambda: tilted.estimate(series("R+10"), TRIAD).warnings,
    "a series cut short": a_cut_series,
    "a dead zone": a_dead_zone,
    "no channel of a gimbal": lambda: a_rocking_test("gimbal_inner"),
    "other rings": lambda: a_rocking_test(axes=2),
    "a reversed accelerometer": lambda: platform_drifts(20.0, 0.2, 0.2, 0.2),
    "a reversed gimbal": lambda: platform_drifts(0.2, 0.2, 0.2, 1.0),
    "no table": lambda: a_rocking_test(axes=0),
    "highest order": lambda: (
        temperatures.model(temperatures.given(np.arange(8.0), np.arange(8.0) ** 3, 1e-6), highest_order=2).warnings
    ),
    "a segment unlike the others": lambda: flexure.estimate(np.eye(8, 2) * 50, error=0.01).warnings,
    "a reversed axis": lambda: responding((1, 0, 0), (0, -1, 0), (0, 0, 1)),
    "exchanged axes": lambda: responding((0, 1, 0), (1, 0, 0), (0, 0, 1)),
    "all accelerometers reversed": lambda: responding((-1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "all gyros reversed": lambda: responding((-1, 0, 0), (0, -1, 0), (0, 0, -1), text="deg/s", kind="gyro"),
    "a wrong unit": lambda: responding((57.3, 0, 0), text="rad/s", kind="gyro"),
    "half the sensitivity": lambda: responding((0.5, 0, 0)),
    "unlike the nominal value": lambda: against_nominal([("K_x", -1.0, 1.0), ("K_y", 3.0, 1.0)]),
    "a line at short averaging times": lambda: (
        allan.run(allan.record(allan.white(2**14) + 20 * np.sin(np.arange(2**14) * 2.5))).warnings
    ),
    "a single cycle of temperature": lambda: (
        temperatures.model(
            recorded=temperatures.cycle(1, 1, True)[1:], channels=("gyro",), temperature_channel="inside", order=1
        ).warnings
    ),
    "start-ups in blocks": lambda: (
        repeats.of_values({f"r{k:02d}": 9.0 * (k // 20) + (-1) ** k for k in range(60)}).warnings
    ),
    "groups that scatter differently": lambda: (
        repeats.of_values(
            {f"{day}{k}": size * (-1.0) ** k for day, size in (("a", 1.0), ("b", 50.0)) for k in range(8)},
            groups={"a": ("a*",), "b": ("b*",)},
        ).warnings
    ),
    "repeats that scatter and drift": lambda: repeats.of_values({f"r{k}": float(k) for k in range(9)}).warnings,
    "a drift that the segments show": lambda: drifting_line(CAMPAIGNS["scale_factor"]).warnings,
    "samples lost": lambda: lost(1),
    "samples lost in many segments": lambda: lost(5),
}


@pytest.mark.parametrize("what", WARNED)
def test_warnings_are_translated(what: str) -> None:
    warnings = WARNED[what]()
    assert warnings
    for language in languages():
        assert not untranslated(warnings, language)
