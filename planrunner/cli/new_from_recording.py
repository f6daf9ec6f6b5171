"""`planrunner new --from-recording`: examines a file of samples and writes a first bench, a first plan and a picture."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import InputError, Mark, count_of
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_json, write_new
from planrunner.cli.progress import reading_progress
from planrunner.plan.quantity import QuantityError, parse_quantity

if TYPE_CHECKING:
    from planrunner.base.documents import JsonObject
    from planrunner.instruments.formats.guessing import LikelyTime
    from planrunner.instruments.recording_look import Look
    from planrunner.instruments.recording_motion import TurnComparison


def new_from_recording(recording: Path, target: str | None, rate: str | None, *, as_json: bool) -> int:
    """Writes PLAN.yaml, PLAN.bench.yaml and PLAN.svg for a recording, and prints a description of the recording. `target`: the file
    for the plan; by default, it is named after the recording and lies in the current folder. `rate`: sample rate, for a file
    without a time column. If anything fails, raises `InputError` and writes nothing."""
    from planrunner.instruments.recording_look import look_at
    from planrunner.reporting.recording_picture import recording_picture
    from planrunner.tasks.begin_from_recording import bench_of, plan_of

    plan = Path(target or f"{recording.stem}.yaml")
    plan = plan.with_name(f"{re.sub(r'[^A-Za-z0-9_-]+', '_', plan.stem).strip('_') or 'recording'}.yaml")
    files = {"plan": plan, "bench": plan.with_suffix(".bench.yaml"), "picture": plan.with_suffix(".svg")}
    for file in files.values():
        if file.exists():
            raise InputError.at(Mark(str(file)), "new-exists", "this file exists already", "choose another name")
    with reading_progress(as_json) as notice:
        look = look_at(recording, None if rate is None else _rate(rate), notice)
    texts = (plan_of(look, plan.stem), bench_of(look, plan.stem), recording_picture(look))
    for file, text in zip(files.values(), texts, strict=True):
        write_new(file, text.encode())
    if as_json:
        print_json({**_json(look), **{name: str(file) for name, file in files.items()}})
        return exit_codes.DONE
    _print(look)
    folder = recording.parent if str(recording.parent) != "." else Path()
    print(f"\nWritten: {', '.join(str(file) for file in files.values())}. Correct the guesses, then check them with:")
    print(f"planrunner check {plan} --data {folder}")
    return exit_codes.DONE


def _rate(text: str) -> float:
    try:
        rate = parse_quantity(text, "frequency").value
    except QuantityError as error:
        raise InputError.at(Mark("--sample-rate"), "form-quantity", str(error), "write for example '100 Hz'") from None
    if not rate > 0:
        raise InputError.at(
            Mark("--sample-rate"), "meaning-range", "a sample rate is positive", "write for example '100 Hz'"
        )
    return rate


def _time(time: LikelyTime) -> JsonObject:
    own: JsonObject = {"column": time.column, "unit": time.unit}
    if time.per_second is not None:
        own = {"column": time.column, "per_second": time.per_second}
    return own if time.wraps is None or time.written else {**own, "wraps": time.wraps}


def _json(look: Look) -> JsonObject:
    return {
        "file": look.file,
        "format": None if look.format is None else look.format.type,
        "time": None if look.time is None else _time(look.time),
        "sample_rate_hz": look.rate,
        "rows": look.rows,
        "channels": [
            {"channel": one.name, "column": one.column, "unit": one.unit, "counts": one.counts, "noise": one.noise}
            for one in look.channels
        ],
        "other_columns": list(look.other),
        "contents": list(look.contents),
        "still_s": [[span.start, span.end] for span in look.still],
    }


def _print(look: Look) -> None:
    from rich.table import Table

    from planrunner.reporting import terminal

    time = (
        "no time: rows are counted"
        if not look.backwards
        else f"the time does not increase in {count_of(look.backwards, 'row')}: rows are counted"
    )
    if look.time is not None:
        unit = look.time.unit if look.time.per_second is None else f"{look.time.per_second:.12g} counts per second"
        doubt = f"; {look.time.doubt}" if look.time.doubt else ""
        time = f"time in '{look.time.column}' [{unit}]{doubt}"
    seconds = look.rows / look.rate if look.time is None or not len(look.windows.end) else look.windows.end[-1]
    print(f"{look.file}: {look.rows} rows at {look.rate:.6g} Hz, {seconds:.4g} s; {time}")
    if look.contents:
        print(*look.contents, sep="\n")
    table = Table("channel", "column", "unit", "scatter at rest" if look.still else "scatter in motion", "guessed from")
    for one in look.channels:
        scale = f"{one.unit}, {one.per_unit:g} counts each" if one.counts else one.unit
        origin = one.source if not one.counts else f"{one.source}: raw counts"
        table.add_row(one.name, one.column, scale, "never changes" if one.stands else f"{one.noise:.3g}", origin)
    terminal.console().print(table)
    if look.other:
        print(f"other columns of numbers: {', '.join(look.other[:20])}{' …' if len(look.other) > 20 else ''}")
    for reason in look.unread:
        print(f"not read: {reason}")
    if look.sparse:
        print(f"columns with a number in few rows, not used: {', '.join(look.sparse)}")
    if look.other_rate is not None:
        print(f"the rate changes: about {look.other_rate[0]:.3g} Hz from {look.other_rate[1]:.4g} s")
    if look.motion is not None:
        _print_motion(look, look.motion)
    if look.named_accel:
        print(look.named_accel)
    count = len(look.still)
    print(f"still: {100 * look.still_share:.0f} % of the time, in {count_of(count, 'span')} of at least 2 s")


def _print_motion(look: Look, motion: TurnComparison) -> None:
    from planrunner.tasks.begin_from_recording import axes_note

    if look.reversed_axes:
        print(*axes_note(motion.axes), sep="\n")
    named = next((one.unit for one in look.channels if one.sensed == "gyro" and one.source == "name"), motion.unit)
    if named != motion.unit and not any(one.counts for one in look.channels):
        print(
            f"the columns of the gyros name the unit {named}, but the turns that the accelerometers show agree with {motion.unit}"
        )
