"""Recordings that cannot be navigated: a clear sentence each."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorded import from_samples
from standing_unit import RATE, SITE, recorded, request, samples

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.interface import EstimationError, Setup
from planrunner.estimators.strapdown.strapdown_navigation import StrapdownNavigation
from planrunner.plan.schedule import Spin


def stop(seconds: float = 300, **options: Any):
    return recorded("align", samples(seconds, noise=1e-3), 0.0, **options)


def run(seconds: float = 300, start: float = 300.0, **options: Any):
    return recorded("navigate", samples(seconds, noise=1e-3, seed=1), start, **options)


def refused(words: str, *segments: RecordedSegment, **options: Any) -> None:
    with pytest.raises(EstimationError, match=words):
        StrapdownNavigation().estimate(request(*segments, **options))


def changed(item, time=None, **channels):
    """A recorded segment with other samples."""
    data = {name: np.concatenate([block.channels[name] for block in item.blocks([name])]) for name in item.units}
    stamps = np.concatenate([block.time for block in item.blocks([])])
    for name, change in channels.items():
        data[name] = change(data[name])
    kept = slice(None)
    if time is not None:
        stamps, kept = time(stamps)
    return from_samples(item.segment, stamps, {name: values[kept] for name, values in data.items()}, item.units)


def test_segments() -> None:
    refused("none of the segments is for alignment", run(), run())
    refused("no segment follows 'align'", stop())
    refused("'align' and 'align' are both for alignment", stop(), stop(), run())
    refused("too short for alignment: it has samples for 20 s", stop(20), run())
    refused("turns continuously", stop(motion=Spin(0.1)), run())


def test_channels_and_units() -> None:
    refused("no channel 'gyro_q'", stop(), run(), gyros=("gyro_x", "gyro_y", "gyro_q"))
    refused("channel 'accel_x' is in V", stop(more_units={"accel_x": "V"}), run())
    refused("channel 'gyro_x' is in deg/h", stop(), run(), accelerometers=("gyro_x", "gyro_y", "gyro_z"))
    swapped = ("gyro_y", "gyro_z", "gyro_x")
    refused("the gyros measure", stop(), run(), gyros=swapped)
    milli = dict.fromkeys(("accel_x", "accel_y", "accel_z"), "mg")
    refused("mean specific force is 0.0098", stop(more_units=milli), run())


def test_samples_that_are_no_number() -> None:
    def blank(values):
        values = values.copy()
        values[1000:1010] = np.nan
        return values

    refused("samples are missing for 1.1 s after", stop(), changed(run(), gyro_y=blank))
    refused("has no usable samples", changed(stop(), accel_z=lambda v: np.full_like(v, np.nan)), run())
    refused("hold no usable samples", stop(), changed(run(), accel_z=lambda v: np.full_like(v, np.nan)))


def test_gaps_and_clock() -> None:
    def gap(t):
        kept = np.delete(np.arange(t.size), slice(500, 600))
        return t[kept], kept

    def back(t):
        t = t.copy()
        t[700:] -= 3.0
        return t, slice(None)

    def twice(t):
        t = t.copy()
        t[700] = t[699]
        return t, slice(None)

    def slow(t):
        return t[0] + 2 * (t - t[0]), slice(None)

    refused("samples are missing for 10.1 s after 350.", stop(), changed(run(), time=gap))
    refused("the clock goes from", stop(), changed(run(), time=back))
    refused("the clock goes from", stop(), changed(run(), time=twice))
    refused("has a sample every 0.2 s, but the plan and the bench give 0.1 s", stop(), changed(run(), time=slow))
    refused("different sample rates", stop(), run(rate=20.0))


def test_pause_between_alignment_and_navigation() -> None:
    later = run(start=400.0)
    found = StrapdownNavigation().estimate(request(stop(), later))
    assert any("no samples for 100 s" in note for note in found.notes)
    refused("does not begin in the orientation", stop(), run(start=400.0, attitude=np.eye(3)[[1, 2, 0]]))
    moving = changed_reference(run(start=400.0), 5.0)
    refused("the carrier may have turned", stop(), moving)


def changed_reference(item, speed):
    n = item.statistics.count
    data = {name: np.concatenate([block.channels[name] for block in item.blocks([name])]) for name in item.units}
    data["reference_velocity_north"] = np.full(n, speed)
    return recorded("navigate", data, 400.0, more_units={"reference_velocity_north": "m/s"})


def test_a_unit_that_is_not_at_rest() -> None:
    turning = recorded("align", samples(300, angle=np.linspace(0, 0.05, 3001), noise=1e-3), 0.0)
    refused("the gyros measure", turning, run())
    data = samples(300, noise=1e-3)
    data["accel_x"] = data["accel_x"] + 0.03 * np.sin(2 * np.pi * np.arange(3000) / RATE / 60)
    refused("the unit moved during alignment", recorded("align", data, 0.0), run())
    data = samples(300, noise=1e-3)
    data["reference_velocity_east"] = np.full(3000, 2.0)
    refused(
        "the carrier moves at up to 2 m/s",
        recorded("align", data, 0.0, more_units={"reference_velocity_east": "m/s"}),
        run(),
    )


def test_gyros_that_cannot_find_north() -> None:
    refused("north is only known to", recorded("align", samples(300, noise=0.2), 0.0), run())
    biased = samples(300, errors=(8, 0, 0, 0, 0, 0), noise=1e-3)
    refused("such errors cannot find north", recorded("align", biased, 0.0), run())


def test_near_the_pole() -> None:
    polar = replace(SITE, latitude=math.radians(88))
    refused("north cannot be found", recorded("align", samples(300, site=polar), 0.0), run(), site=polar)


def test_stated_positions_that_are_invalid() -> None:
    told = Setup(information={"initial_latitude": "somewhere"})
    refused("run information initial_latitude is 'somewhere'", stop(), run(), setup=told)
    for text in ("95 deg", "nan", "-91"):
        refused("not a place on Earth", stop(), run(), setup=Setup(information={"initial_latitude": text}))
