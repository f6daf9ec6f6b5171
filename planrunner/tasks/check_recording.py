"""The checks of the recording behind a plan, before it is run: the file from its first row to its last, then every estimate, tried on it.

What is found goes where the other findings of a plan go. No value is kept: a check says whether a run will come to its end, not how.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from planrunner.archive.played_back import played
from planrunner.base.findings import Mark
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import driver_of
from planrunner.estimators.analysis import analyse
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.recording import RecordingPlayer
from planrunner.tasks.check import Checked, Sound


def check_recording(checked: Checked, data_root: Path, progress: Callable[[int], None] | None = None) -> None:
    """Adds what is wrong with the recording that a plan's bench plays back; nothing for another bench. progress: called with the rows
    looked at so far. Never raises for what the files hold."""
    bench, models, log = checked.bench, checked.models, checked.findings
    if bench is None or models is None:
        return
    segments = checked.schedule.segments if checked.schedule else ()
    for entry in bench.instruments.values():
        if driver_of(entry) is not RecordingPlayer:
            continue
        try:
            player = RecordingPlayer.connect(entry.parameters, Surroundings(VirtualClock(), models.site, data_root))
        except InstrumentError as error:
            hint = "check the bench file, --data and the plan's labels"
            log.error("recording-unfit", entry.origin.mark, str(error), hint)
            return
        if segments:
            player.look_over(segments, log, progress)
        if checked.ok:
            _try_estimates(checked.sound(), player)


def _try_estimates(sound: Sound, player: RecordingPlayer) -> None:
    """Every estimate of a plan on the recording: those that it cannot give are errors."""
    estimates = {name: replace(spec, validate=None) for name, spec in sound.plan.estimates.items()}
    try:
        recording = played(player, sound.schedule.segments)
    except InstrumentError as error:
        mark = Mark(player.parameters.file)
        sound.findings.error(
            "recording-unfit", mark, str(error), "correct the file, or its description in the bench file"
        )
        return
    results = analyse(estimates, (), recording, sound.models.site, sound.sensor, sound.setup)
    for name, message in results.failures.items():
        hint = "choose other segments or parameters, or record what is missing"
        sound.findings.error("recording-estimate", estimates[name].origin.mark, f"'{name}': {message}", hint)
