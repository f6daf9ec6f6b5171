"""Writes a first bench file and a first plan for a recording that has neither yet."""

from __future__ import annotations

import re

from planrunner.base.findings import count_of
from planrunner.instruments.recording_look import AT_LEAST, MOVING, WINDOW, Look, poses
from planrunner.plan.kinds import Record, keys_of
from planrunner.plan.span import Span

POSES = 9
"""Number of poses that a calibration from the magnitude of gravity needs. Such a calibration determines three biases, three scale
factors and three angles."""
LEAST_POSES, LEAST_RESTS = 2, 4
"""Smallest numbers of poses and of intervals at rest that a diagnosis can compare."""
MOST_CONTENTS = 20
"""Maximum number of tables of the file that the bench file lists."""
STILL = 0.9
"""A recording counts as a recording at rest if more than this fraction of its time is without motion."""


_DOUBTS = {
    "name": "",
    "motion": " # the unit was determined from the turns that the accelerometers show",
    "size": " # the unit is a guess",
    "counts": " # raw counts: enter the sensitivity",
    "increments": " # increments: per_unit is the sample period in s",
}
_NOISE = {"degC": ("K", 1.0), "degF": ("K", 5 / 9)}
"""For each unit of temperature: the unit of a temperature difference, and the conversion factor."""
_UNCHANGED = 1e-6
"""Threshold, in the unit of the accelerometers, if counts are so coarse that no reading changes at rest. It must be positive."""


def axes_note(axes: tuple[str, str, str]) -> tuple[str, str]:
    """Returns the message and the hint of a finding about wrong axes. `axes`: the actual input axes of the gyros x, y and z, in the
    frame of the accelerometers. An axis is empty if it is unknown."""
    known = zip("xyz", (axis or "an unknown axis" for axis in axes), strict=True)
    turns = ", ".join(f"gyro_{gyro} turns about {axis}" for gyro, axis in known)
    return (
        f"Gyros and accelerometers have different axes. In the axes of the accelerometers: {turns}.",
        "Exchange columns, or write `sign: -1` for a channel, until the gyros and the accelerometers have the same axes.",
    )


def _quoted(text: str) -> str:
    """Returns a text as a value in YAML, in quotes if they are necessary."""
    return text if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_./]*", text) else "'" + text.replace("'", "''") + "'"


def _stated(keys: Record) -> list[str]:
    """Returns, as lines of YAML, the keys of a record whose values differ from the defaults. The separator of a text is always
    stated."""
    found = []
    for name, item in keys_of(type(keys)).items():
        value = getattr(keys, item.name)
        if value != item.default or name == "separator":
            shown = f"[{', '.join(map(_quoted, value))}]" if isinstance(value, tuple) else _quoted(str(value))
            found.append(f"{name}: {shown if isinstance(value, tuple | str) else value}")
    return found


def bench_of(look: Look, name: str) -> str:
    """Returns the text of a bench file for playing the recording back. `name`: name of the bench."""
    lines = [
        "planrunner_bench: 1",
        f"name: {name}",
        f"description: Plays back {_quoted(look.file)}. Everything here was guessed from names and numbers; check it.",
        "clock: virtual",
        "# The place is not in the file. Enter the latitude and the gravity of the laboratory.",
        "site: {latitude: 45 deg, gravity: 9.80665 m/s^2}",
        "instruments:",
        "  imu:",
        "    driver: recording",
        f"    file: {_quoted(look.file)}",
    ]
    lines += [f"    # It contains the {one}." for one in look.contents[:MOST_CONTENTS]]
    if look.format is not None:
        stated = [f"type: {look.format.type}", *_stated(look.format.parameters)]
        if look.format.readings is not None:
            stated.append(f"readings: {{{', '.join(_stated(look.format.readings))}}}")
        lines.append(f"    format: {{{', '.join(stated)}}}")
    lines.append("    kind: imu")
    if look.backwards:
        lines.append(
            f"    time: sample_count # in {count_of(look.backwards, 'row')} the time of the file does not increase: rows are counted"
        )
    elif look.time is None:
        lines.append("    time: sample_count # the file has no time, or the sample rate was given")
    else:
        time = look.time
        scale = f"unit: {time.unit}" if time.per_second is None else f"per_second: {time.per_second:.12g}"
        wraps = "" if time.wraps is None or time.written else f", wraps: {time.wraps:.0f}"
        doubt = f" # {time.doubt}" if time.doubt else ""
        lines.append(f"    time: {{column: {_quoted(time.column)}, {scale}{wraps}}}{doubt}")
    lines.append(f"    sample_rate: {look.rate:.6g} Hz")
    if look.other_rate is not None:
        rate, begin = look.other_rate
        lines.append(
            f"    # The rate changes: about {rate:.3g} Hz from {begin:.4g} s. An estimate that needs one rate,"
        )
        lines.append("    # such as allan_deviation, needs segments that do not contain this change.")
    count, shortest = look.pauses
    if count and not look.backwards:
        steps = f"The time jumps by {shortest:.3g} s or more in {count_of(count, 'place')}"
        if look.bursts:
            lines += [f"    # {steps}: each piece is a segment.", f"    pauses: {shortest / 2:.3g} s"]
        else:
            lines.append(f"    # {steps}. To make each piece a segment: pauses: {shortest / 2:.3g} s")
    if look.motion is not None and look.reversed_axes:
        lines += [f"    # {part}" for part in axes_note(look.motion.axes)]
    lines.append("    channels:")
    for one in look.channels:
        counts = f", per_unit: {one.per_unit:.6g}" if one.counts or one.increments else ""
        known = one.noise > 0 and look.still  # the scatter of a motion is no noise
        unit, size = _NOISE.get(one.unit, (one.unit, 1.0))
        noise = f", noise: {size * one.noise:.3g} {unit}" if known else ""
        doubt = _DOUBTS["counts" if one.counts else "increments" if one.increments else one.source]
        doubt += " # it never changes: the output is dead, or the column is wrong" if one.stands else ""
        lines.append(f"      {one.name}: {{column: {_quoted(one.column)}, unit: {one.unit}{counts}{noise}}}{doubt}")
    if look.dwells:
        lines.append(
            "    # The intervals without acceleration. Spin-up and stop are left out. Times are counted from the first row."
        )
        lines.append("    stretches:")
        lines += [
            f"      {label}: {{start: {span.start:.3f} s, end: {span.end:.3f} s}}" for label, span in _labelled(look)
        ]
    if look.sparse:
        lines.append(f"    # Columns with a number in few rows, from a slower instrument: {', '.join(look.sparse)}.")
        lines.append("    # If such a column were a channel, all rows without a number in it would be left out.")
    lines += [f"    # Not read: {reason}" for reason in look.unread[:MOST_CONTENTS]]
    if look.other:
        lines.append(f"    # Other columns of numbers: {', '.join(look.other[:40])}")
    return "\n".join(lines) + "\n"


def _labelled(look: Look) -> list[tuple[str, Span]]:
    """Returns the dwells of a recording in which a table turned at different rates. Each dwell gets a label."""
    return [(f"dwell_{number}", span) for number, span in enumerate(look.dwells, start=1)]


def _dwell_lines(look: Look) -> list[str]:
    """Returns the segments of a plan for a recording with different rates. Comments state the mean of each gyro."""
    gyros = [one for one in look.channels if one.sensed == "gyro"]
    lines = []
    for label, span in _labelled(look):
        seen = ", ".join(f"{one.name} {look.mean_in(span, one):.4g} {one.unit}" for one in gyros)
        lines.append(f"  - {{label: {label}, orientation: unknown, dwell: recorded}} # {seen}")
    return lines


def _segment_lines(look: Look) -> list[str]:
    """Returns the segments of a plan: one for each rate, for each piece of the recording, or for the whole recording."""
    if look.dwells:
        return _dwell_lines(look)
    if look.bursts:
        return [
            f'  - {{label: "part_{{repeat}}", repeat: {look.pauses[0] + 1}, orientation: unknown, dwell: recorded}}'
        ]
    return ["  - {label: all, orientation: unknown, dwell: recorded}"]


def plan_of(look: Look, name: str) -> str:
    """Returns the text of a first plan for the recording. `name`: name of the bench that the plan uses."""
    outputs = [one.name for one in look.channels if one.sensed in ("gyro", "accel")]
    live = [one.name for one in look.channels if one.name in outputs and not one.stands]
    lines = [
        "planrunner: 1",
        f"title: {_quoted(f'First look at {look.file}')}",
        f"bench: ./{name}.bench.yaml",
        f"sensor: {{kind: imu, outputs: [{', '.join(outputs)}]}}",
        "segments:",
        *_segment_lines(look),
    ]
    triad = [one for one in look.channels if one.name in ("accel_x", "accel_y", "accel_z")]
    estimates: list[str] = []
    diagnosis: list[str] = []
    directions = poses(look.windows, look.still, triad) if len(triad) == 3 else 0
    if look.dwells:
        lines += [
            "# The gyros show different rates. The recording does not contain the rates of the table. Write them into the segments,",
            "# such as {label: dwell_2, orientation: {x: east, z: up}, rate: 10 deg/s, dwell: recorded}, then add estimates such as",
            "# scale_factor.",
        ]
    elif directions >= LEAST_POSES and len(look.still) >= LEAST_RESTS:
        threshold = MOVING * max(one.noise for one in triad) or _UNCHANGED
        still = f"{{detect: still, window: {WINDOW:g} s, threshold: {threshold:.3g} {triad[0].unit}, at_least: {AT_LEAST:g} s}}"
        if directions >= POSES:
            estimates = [
                "  accelerometer:",
                "    estimator: accelerometer_multi_position",
                "    reference: gravity_magnitude",
                f"    segments: {still}",
            ]
        diagnosis = ["diagnosis:", "  nominal: [accel_bias]", f"  segments: {still}"]
    elif look.still_share > STILL and live and directions <= 1 and look.other_rate is None:
        estimates = [
            "  noise:",
            "    estimator: allan_deviation",
            f"    segments: {'part_*' if look.bursts else 'all'}",
            f"    outputs: [{', '.join(live)}]",
        ]
    if estimates:
        lines += ["estimates:", *estimates]
    lines += diagnosis
    if look.bursts and not look.dwells:
        lines.append(
            "# The recording consists of separate pieces, in the order of time. Write the states of the sensor into the segments."
        )
    elif not estimates and not look.dwells:
        lines.append(
            "# Add `segments` to the bench, with a table of labels and times, and then estimates: see docs/plan-language.md"
        )
    lines.append("report: [report.html, summary.md]")
    return "\n".join(lines) + "\n"
