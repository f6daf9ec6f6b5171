"""Rocking drift from recordings made apart from planrunner: known drifts come back, figures of the method are met, bad data are refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recorded import figure, from_samples
from rocking_recordings import (
    ACCELEROMETERS,
    ARCSEC,
    ATTITUDES,
    DEG,
    ENCODERS,
    GRAVITY,
    LATITUDE,
    PER_HOUR,
    TABLE,
    World,
    estimate,
    planned,
    recordings,
    samples,
    units,
)

from planrunner.archive.recording import IN_MODE
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import EstimationError, Setup
from planrunner.instruments.models import TableModel
from planrunner.plan.schedule import Rest, Spin
from planrunner.uncertainty.influences import InputQuantity, Inputs

DRIFT = np.array([0.2, -0.3, 0.15]) * PER_HOUR
ROCKING = np.array([0.05, -0.08, 0.03]) * PER_HOUR
LASTING = (480 - 60.9) / 538  # the base rocks until 480 s; the first window, of ten samples, has its middle at 60.9 s


def quadruple(drift=DRIFT, rocking=ROCKING, **of_all) -> list[World]:
    rest, rocks = World(drift=drift, **of_all), World(drift=drift, rocking=rocking, **of_all)
    return [rest, rocks, rocks, rest]


def both(four: list[World] | None = None, **how) -> list:
    four = four or quadruple()
    return recordings([("vertical", four), ("horizontal", four)], **how)


@pytest.fixture(scope="module")
def quiet():
    return both()


def test_known_rocking_drifts_come_back_about_all_axes(quiet):
    found = estimate(quiet)
    truth = ROCKING / PER_HOUR * LASTING
    assert [item.name for item in found.coefficients] == [
        *("drift_x", "drift_y", "drift_z", "gimbal_drift_x", "gimbal_drift_y", "gimbal_drift_z")
    ]
    assert all(item.unit == "deg/h" for item in found.coefficients)
    # 3 % of the drift about the vertical axis reads as one about a level axis, because the element tilts by 1.7 deg.
    leak = 0.03 * np.abs(truth).max()
    np.testing.assert_allclose(found.values("drift_x", "drift_y", "drift_z"), truth, atol=leak)
    np.testing.assert_allclose(found.values("gimbal_drift_x", "gimbal_drift_y", "gimbal_drift_z"), truth, atol=1e-4)


def test_one_rocking_drift_about_a_level_axis_comes_back_exactly():
    four = quadruple(np.zeros(3), np.array([0.05, 0.0, 0.0]) * PER_HOUR)
    found = estimate(recordings([("vertical", four)]))
    assert found["drift_x"].value == pytest.approx(0.05 * LASTING, abs=1e-5)
    assert found["drift_z"].value == pytest.approx(0.0, abs=1e-5)


def test_each_run_is_free_of_the_earth(quiet):
    """Step 5: what stands for a run is its drift against inertial space, not the 11.5 deg/h of the Earth about north."""
    rows = {row[0]: row[1] for row in next(table for table in estimate(quiet).tables if "each run" in table.title).rows}
    x, z = (float(part.split()[1]) for part in str(rows["vertical/static-1"]).split(", "))
    assert x == pytest.approx(0.2, abs=0.01)
    assert z == pytest.approx(0.15, abs=0.01)


@pytest.mark.parametrize("order", ["xzy", "zxy"])
def test_the_order_of_the_turns_does_not_matter_for_the_drift(quiet, order):
    found = estimate(quiet, f"{{rotation_order: {order}}}")
    np.testing.assert_allclose(found.values("drift_x", "drift_z"), (ROCKING * LASTING / PER_HOUR)[[0, 2]], atol=2e-3)


def test_installation_angles_are_compensated():
    angles = np.array([300.0, -250.0, 200.0, 350.0, -150.0, 280.0]) * ARCSEC
    keys = ", ".join(
        f"{name}: {angle / ARCSEC:g} arcsec"
        for name, angle in zip(("xz", "xy", "yz", "yx", "zy", "zx"), angles, strict=True)
    )
    four = quadruple(installation=angles)
    recorded = recordings([("vertical", four)])
    plain = estimate(recordings([("vertical", quadruple())]))
    compensated = estimate(recorded, f"{{installation_angles: {{{keys}}}}}")
    runs = [{r[0]: r[1] for r in item.tables[-1].rows}["vertical/static-1"] for item in (plain, compensated)]
    assert runs[0] == runs[1]
    # the Earth's 11.5 deg/h about x reads as one about z through 200 arcsec about y, unless compensated
    missed = {r[0]: r[1] for r in estimate(recorded).tables[-1].rows}["vertical/static-1"]
    assert missed != runs[0]


def test_rocking_that_shakes_the_accelerometers_is_filtered_out():
    shaken = [World(drift=DRIFT), *[World(drift=DRIFT, rocking=ROCKING, shaking=0.01)] * 2, World(drift=DRIFT)]
    still = estimate(recordings([("vertical", quadruple())]))
    found = estimate(recordings([("vertical", shaken)]))
    assert abs(found["drift_x"].value - still["drift_x"].value) < 2e-4
    # a millig that is let through would be 200 arcsec
    through = estimate(recordings([("vertical", shaken)]), "{cutoff: 0.5 Hz}")
    assert abs(through["drift_x"].value - still["drift_x"].value) > 0.01


def azimuths(dynamic: float, static: float = 0.0) -> list[World]:
    rest = World(caged=np.array([0.0, static, 0.0]))
    rocks = World(caged=np.array([0.0, dynamic, 0.0]), release=5.0)  # a period to fade the rocking in
    return [rest, rocks, rocks, rest]


def test_a_tenth_of_a_degree_of_azimuth():
    """Not modelled it is Ω·cos φ · 0.1° = 0.0201 deg/h about east; modelled by the encoders, below 3e-4 deg/h."""
    recorded = recordings([("vertical", azimuths(0.1 * DEG))])
    assert abs(estimate(recorded, "{azimuth: nominal}")["drift_z"].value) == pytest.approx(0.020, abs=5e-4)
    assert abs(estimate(recorded)["drift_z"].value) < 3e-4
    alike = recordings([("vertical", azimuths(0.1 * DEG, 0.1 * DEG))])
    assert abs(estimate(alike, "{azimuth: nominal}")["drift_z"].value) < 3e-4


def released_with_the_record() -> list:
    return recordings([("vertical", [World()] * 4)])


def test_records_that_begin_with_the_release():
    """Planned runs fade the rocking in for 5 s before their record begins. Where the records begin with the release, 5 s of the Earth's
    turn about up are 48 arcsec of azimuth: Ω cos φ · (5 s · Ω sin φ) = 0.0027 deg/h about z, in the dynamic runs alone."""
    recorded = released_with_the_record()
    wrong = 11.5221 * 5 * 15.041067 / 3600 * math.sin(LATITUDE) * math.pi / 180
    assert estimate(recorded, "{azimuth: nominal}")["drift_z"].value == pytest.approx(-wrong, abs=2e-4)
    stated = estimate(recorded, "{azimuth: nominal, released_before: 0 s}")
    assert abs(stated["drift_z"].value) < 1e-4


def test_the_recorded_release_goes_before_the_planned_one():
    recorded = [replace(item, readings={IN_MODE: 0.0}) for item in released_with_the_record()]
    assert abs(estimate(recorded, "{azimuth: nominal}")["drift_z"].value) < 1e-4


def test_a_played_back_recording_leaves_the_release_open():
    recorded = released_with_the_record()
    with pytest.raises(EstimationError, match="'vertical/static-1' is not known: write `released_before`"):
        estimate(recorded, "{azimuth: nominal}", Setup(TABLE, replayed=True))
    estimate(recorded, "{azimuth: nominal, released_before: 0 s}", Setup(TABLE, replayed=True))
    estimate(recorded, setup=Setup(TABLE, replayed=True))  # encoders show the azimuth


def test_a_base_that_rests_before_it_rocks(quiet):
    """The drift before the rocking is that of the resting element; the rocking drift is the same as of a base that rocks at once, over the
    480 s of rocking, all of which lie between the windows now. No drift about the vertical, which would leak into the others."""
    drift, rocking = DRIFT * [1.0, 0.0, 1.0], ROCKING * [1.0, 0.0, 1.0]
    rest = World(drift=drift)
    rocks = World(drift=drift, rocking=rocking, rest=120.0)
    found = estimate(recordings([("vertical", [rest, rocks, rocks, rest])], dwell=700.0))
    assert found["drift_x"].value == pytest.approx(ROCKING[0] / PER_HOUR * 480 / 638, abs=3e-4)
    table = next(table for table in found.tables if table.title.startswith("Static drift before"))
    assert [row[:2] for row in table.rows] == [(f"vertical/dynamic-{n}", axis) for n in (1, 2) for axis in "xz"]
    for _, axis, before, whole in table.rows:
        k = "xyz".index(str(axis))
        assert figure(before) == pytest.approx(DRIFT[k] / PER_HOUR, abs=4e-3)  # over 57 s, 0.004 deg/h are 0.2 arcsec
        assert figure(whole) == pytest.approx((DRIFT[k] + ROCKING[k] * 480 / 638) / PER_HOUR, abs=2e-3)
    assert not any(table.title.startswith("Static drift before") for table in estimate(quiet).tables)


def test_the_second_window_stands_where_the_plan_says(quiet):
    """Within the rocking its share is whole; a window beyond the record is refused."""
    found = estimate(quiet, "{second_window: 400 s}")
    assert found.settings["t1"] == "400 s"
    assert found["drift_x"].value == pytest.approx(ROCKING[0] / PER_HOUR, abs=3e-4)
    with pytest.raises(EstimationError, match="ends at 601 s, after the end of the shortest record"):
        estimate(quiet, "{second_window: 599 s}")


def test_the_curve_of_the_drift_angle(quiet):
    """A straight line of the element's drift while the base rests, and of both drifts together while it rocks."""
    plot = next(item for item in estimate(quiet).plots if item.title.startswith("Drift angle about x (state: vertical"))
    time = np.array(plot.x)
    assert time[0] == 2.5
    assert np.allclose(np.diff(time), 5.0)  # a rocking period
    for name, slope in (("static 1", DRIFT[0]), ("dynamic 2", DRIFT[0] + ROCKING[0])):
        curve = np.array(plot.series[name]) * ARCSEC
        within = time < 470
        found = np.polyfit(time[within], curve[within], 1)[0]
        assert found / PER_HOUR == pytest.approx(slope / PER_HOUR, abs=1e-3)
        assert abs(np.interp(60.9, time, curve)) < 0.5 * ARCSEC


def test_the_return_error_of_the_table_passes_one_to_one_to_the_gimbal_method_alone():
    four = [World(), World(return_error=20 * ARCSEC), World(return_error=20 * ARCSEC), World()]
    found = estimate(recordings([("vertical", four)], seed=3))
    off = next(iter(found.extra["rocking"].values()))[0]
    assert abs(off[0]) < 1e-3
    assert 0.003 < abs(off[2]) < 0.2


def budget(text: str, dwell: float):
    four = [World(bias=np.zeros(3))] * 4
    found = estimate(recordings([("vertical", four)], dwell=dwell), text)
    measured = list(found.coefficients)
    return found, {item.quantity.name: item for item in found.influences}, measured


@pytest.mark.parametrize(
    ("dwell", "release", "seconds", "expected"), [(602.0, 60.0, 540.0, 0.0038), (962.0, 60.0, 900.0, 0.0023)]
)
def test_ten_micro_g_in_the_budget(dwell, release, seconds, expected):
    """1e-5 g is 2.06 arcsec: 0.0038 deg/h over 540 s and 0.0023 over 900 s; one quadruple of four runs with ±½ contributes as much."""
    found, influences, _ = budget(
        f"{{release: {release} s, accelerometer_stability: 10 ug, azimuth_uncertainty: 7 arcsec}}", dwell
    )
    assert found.extra["seconds"] == pytest.approx(seconds, abs=0.2)
    stability = influences["accelerometer stability"]
    assert stability.in_scatter
    size = math.sqrt(stability.covariance[0, 0])
    # An element at rest in inertial space tilts by up to 3.75 deg in 900 s, and the cosine of that is 0.998.
    assert size == pytest.approx(1e-5 * 9.80665 / GRAVITY / seconds * 180 / math.pi * 3600, rel=2.2e-3)
    assert round(size, 4) == expected
    # 7 arcsec of azimuth through Ω·cos φ, four runs with ±½
    heading = influences["azimuth of the element"]
    assert math.sqrt(heading.covariance[1, 1]) == pytest.approx(15.041067 * math.cos(LATITUDE) * 7 * ARCSEC, rel=0.02)


def test_the_figures_of_the_method_stand_in_its_table(quiet):
    table = next(item for item in estimate(quiet, count=1e-6).tables if "Method error" in item.title)
    figures = {row[0]: figure(row[1]) for row in table.rows}
    assert figures["accelerometer stability of 10 µg over 540 s"] == 0.0038
    assert figures["accelerometer stability of 10 µg over 900 s"] == 0.0023
    assert figures["Effect of the Earth rate with an unmodelled azimuth error of 0.1 deg"] == pytest.approx(
        0.0201, abs=1e-4
    )
    assert figures["Effect of the Earth rate with an attitude error of 6.9 arcsec"] == pytest.approx(5e-4, abs=1e-5)


def test_shared_inputs_are_sensitivities_of_the_whole_chain(quiet):
    """Latitude and gravity that are stated wrong move the result as their influences say."""
    stated = {
        "latitude": InputQuantity("latitude", LATITUDE, "rad", 1 * DEG),
        "gravity": InputQuantity("gravity", GRAVITY, "m/s^2", 0.01),
    }
    found = estimate(quiet, "{installation_angles: {yx: 0 arcsec ± 60 arcsec}}", Setup(TABLE, inputs=Inputs(stated)))
    influences = {item.quantity.name: item.sensitivities[:, 0] for item in found.influences if not item.in_scatter}
    four = quadruple(latitude=LATITUDE + 1 * DEG)
    moved = estimate(both(four))
    expected = moved.covariance.shape, [item.value for item in moved.coefficients]
    change = np.array(expected[1]) - np.array([item.value for item in found.coefficients])
    # The truth at a latitude one degree farther, seen with the stated one: minus the sensitivity times one degree.
    np.testing.assert_allclose(change[:3], -influences["latitude"][:3] * DEG, atol=2e-5)
    assert set(influences) == {"latitude", "gravity", "installation angle yx"}


def test_the_intervals_add_up_with_the_budget(quiet):
    found = estimate(quiet, "{accelerometer_stability: 10 ug}")
    assert len(combined(found).budgets) == 6


# -- what is refused -------------------------------------------------------------------------------------------------


def without(recorded, channel):
    changed = []
    for item in recorded:
        left = {name: unit for name, unit in item.units.items() if name != channel}
        changed.append(replace(item, units=left))
    return changed


def edited(recorded, place, change, rows=slice(None)):
    """The recording with one run's channels changed."""
    items = list(recorded)
    target = items[place]
    names = (*ACCELEROMETERS, *ENCODERS)
    blocks = list(target.blocks(names))
    time = np.concatenate([block.time for block in blocks])
    channels = {name: np.concatenate([block.channels[name] for block in blocks]) for name in names}
    change(channels)
    items[place] = from_samples(
        target.segment, time[rows], {name: value[rows] for name, value in channels.items()}, units()
    )
    return items


def refused(recorded, text="{}", setup=None) -> str:
    with pytest.raises(EstimationError) as told:
        estimate(recorded, text, setup)
    return str(told.value)


def test_recordings_that_cannot_serve_are_refused(quiet):
    def halve(channels):
        for name in ACCELEROMETERS:
            channels[name] *= 0.5

    def swap(channels):
        channels["accel_x"], channels["accel_y"] = channels["accel_y"], channels["accel_x"]

    def reverse(channels):
        channels["gimbal_outer"] += 90.0

    def blind(channels):
        channels["accel_x"][2900:2960] = np.nan

    def nothing(channels):
        pass

    assert "0.500 of local gravity" in refused(edited(quiet, 1, halve))
    assert "do not show gravity along y" in refused(edited(quiet, 1, swap))
    assert "deg from the planned one" in refused(edited(quiet, 1, reverse))
    assert "misses 12" in refused(edited(quiet, 1, blind))
    assert "were planned" in refused(edited(quiet, 1, nothing, slice(0, 2000)))
    assert "cut short" in refused([replace(item, truncated=True) for item in quiet])
    assert "no channel 'accel_x'" in refused(without(quiet, "accel_x"))
    assert "azimuth: nominal" in refused(without(quiet, "gimbal_inner"))
    assert "too short for a window" in refused(both(dwell=61.0))
    assert "samples per second" in refused(quiet, "{cutoff: 3 Hz}")


def test_segments_that_are_no_rocking_test_are_refused(quiet):
    assert "a quadruple is static, dynamic, dynamic, static" in refused(quiet[:6])
    assert "static, static" in refused([quiet[1], quiet[1], quiet[3], quiet[5]])
    assert "none of the chosen" in refused([quiet[0]])

    def first(**changed):
        return [replace(quiet[1], segment=replace(quiet[1].segment, **changed)), *quiet[2:8]]

    assert "spins or indexes" in refused(first(motion=Spin(0.1)))
    assert "is unknown" in refused(first(attitude=None))
    tilted = ATTITUDES["vertical"] @ np.array([[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]])
    assert "no axis along the vertical" in refused(first(attitude=tilted))
    assert "orientation changes within" in refused([quiet[1], quiet[3], quiet[5], quiet[15]])


def test_without_encoders_there_is_the_accelerometer_method_alone(quiet):
    found = estimate(without(quiet, "gimbal_inner"), "{azimuth: nominal}")
    assert [item.name for item in found.coefficients] == ["drift_x", "drift_y", "drift_z"]
    assert "gimbal_inner" in found.warnings[0]
    assert all(plot.title.startswith("Drift angle") for plot in found.plots)  # nothing to pair
    other = estimate(quiet, "{azimuth: nominal}", Setup(TableModel(TABLE.axes[:2])))
    assert "2 axes" in other.warnings[0]


def test_a_short_gap_is_bridged(quiet):
    def one(channels):
        channels["accel_z"][300] = np.nan

    found = estimate(edited(quiet, 1, one))
    np.testing.assert_allclose(found.values("drift_x"), estimate(quiet).values("drift_x"), atol=1e-5)


def test_one_state_leaves_the_vertical_axis_out():
    found = estimate(recordings([("vertical", quadruple())]))
    assert [item.name for item in found.coefficients][:2] == ["drift_x", "drift_z"]
    assert any("y is level" in note for note in found.notes)
    assert all(math.isfinite(item.standard_uncertainty) for item in found.coefficients)
    assert {item.degrees_of_freedom for item in found.coefficients} == {1.0}


def test_memory_does_not_grow_with_the_run():
    """Of a long run only the pieces around its windows are kept."""
    from planrunner.estimators.rocking.windows import Windows, read_pieces

    segment = replace(planned("vertical", "static-1", 0, 36_000.0), motion=Rest())
    time, channels = samples("vertical", False, World(), 2.0, 36_000.0, np.random.default_rng(1))
    recorded = from_samples(segment, time, channels, units())
    pieces = read_pieces(recorded, ACCELEROMETERS, Windows(60.0, 35_998.0, 2.0, 0.05, 36_000.0))
    assert sum(len(piece.time) for piece in pieces) <= 2.0 * (60 + 2 + 60 + 62) + 2
