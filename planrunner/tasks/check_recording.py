"""Before a run, checks the recording that the plan plays back: reads the whole file, then tries every estimate.

The findings are added to the findings about the plan. No results are kept. The check shows only whether a run would be completed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planrunner.archive.played_back import played
from planrunner.base.findings import Mark
from planrunner.base.progress import Announce
from planrunner.bench.clock import VirtualClock
from planrunner.estimators.analysis import analyse
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.instruments.recording_summary import SummaryPlayer
from planrunner.tasks.check import Checked, Sound


def check_recording(checked: Checked, data_root: Path, notice: Announce | None = None) -> None:
    """Adds findings about the recording that the bench of a plan plays back. If the bench plays back no recording, no findings are
    added. `notice`: receives the progress. The function raises no error, whatever the files contain."""
    bench, models, log = checked.bench, checked.models, checked.findings
    if bench is None or models is None:
        return
    segments = checked.schedule.segments if checked.schedule else ()
    for entry in bench.instruments.values():
        if not isinstance(entry.parameters, RecordingParameters):
            continue
        try:
            surroundings = Surroundings(VirtualClock(), models.site, data_root, notice=notice)
            player = RecordingPlayer.connect(entry.parameters, surroundings)
        except InstrumentError as error:
            hint = "check the bench file, --data and the plan's labels"
            log.error("recording-unfit", entry.origin.mark, str(error), hint)
            return
        if segments:
            player.look_over(segments, log)
        if checked.ok:
            _try_estimates(checked.sound(), player, notice)


def _try_estimates(sound: Sound, player: RecordingPlayer | SummaryPlayer, notice: Announce | None) -> None:
    """Tries every estimate of a plan on the recording. Adds an error for each estimate that fails."""
    estimates = {name: replace(spec, validate=None) for name, spec in sound.plan.estimates.items()}
    try:
        recording = played(player, sound.schedule.segments)
    except InstrumentError as error:
        mark = Mark(player.parameters.file)
        sound.findings.error(
            "recording-unfit", mark, str(error), "correct the file, or its description in the bench file"
        )
        return
    results = analyse(estimates, (), recording, sound.models.site, sound.sensor, sound.setup, notice)
    for name, message in results.failures.items():
        hint = "choose other segments or parameters, or record the missing data"
        sound.findings.error("recording-estimate", estimates[name].origin.mark, f"'{name}': {message}", hint)
