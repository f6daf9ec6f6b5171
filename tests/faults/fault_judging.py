"""What must be true when a faulty run has ended, and when it was resumed: of the instruments by their own word, of the data, of the run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from small_bench import AMBIENT, DWELL, LABELS, RATE, SmallBench, until
from small_sensors import SmallSensor

from planrunner.archive.run_reader import RunReader

STANDS = 0.002
"""rad/s below which an axis stands: a tenth of a degree a second."""


def not_safe(bench: SmallBench) -> tuple[str, ...]:
    """The instruments that are not in their safe state, by what is true of them: the table at rest and switched off, the chamber set to
    ambient or off."""
    state = bench.state()
    table, chamber = state["table"], state["chamber"]
    moving = any(abs(rate) > STANDS for rate in table["rates"]) or any(table["powered"])
    return ("table",) * moving + ("chamber",) * (chamber["running"] and abs(chamber["setpoint"] - AMBIENT) > 0.01)


def run_folder(bench: SmallBench) -> Path | None:
    """That of the last run of this bench, once its journal is there."""
    found = sorted((bench.folder / "runs").glob("*/journal.jsonl")) if (bench.folder / "runs").exists() else []
    return found[-1].parent if found else None


def events(folder: Path | None) -> list[dict[str, Any]]:
    """The journal so far; a last line may be half written."""
    if folder is None:
        return []
    data = (folder / "journal.jsonl").read_bytes()
    return [json.loads(line) for line in data[: data.rfind(b"\n") + 1].splitlines()]


def begun(folder: Path | None, label: str) -> bool:
    """Whether a segment's last attempt goes on."""
    own = [event["event"] for event in events(folder) if event.get("label") == label and event["event"] != "noticed"]
    return own[-1:] == ["begun"]


def acknowledged(folder: Path | None) -> dict[str, tuple[str, ...]]:
    """Label → digests of its files."""
    found = [event for event in events(folder) if event["event"] == "segment"]
    return {event["label"]: tuple(part["sha256"] for part in event["parts"]) for event in found}


def check_watchdog_is_over(bench: SmallBench, folder: Path | None) -> None:
    """After planrunner was killed the watchdog reports, in words."""
    assert folder is not None
    until(lambda: (folder / "watchdog.txt").exists(), "the watchdog reports")


def check_kept(folder: Path, before: dict[str, tuple[str, ...]]) -> None:
    """No acknowledged segment is lost or changed, and none is there twice."""
    after = acknowledged(folder)
    assert {label: after.get(label) for label in before} == before
    reader = RunReader.open(folder)
    labels = [item.label for item in reader.acknowledged()]
    assert len(labels) == len(set(labels))
    assert reader.check_digests() > 0 and reader.basis.events > 0


def check_complete(folder: Path, sensor: SmallSensor) -> None:
    """A sealed run of all segments whose samples are what the sensor felt: in order, at their rate, with a gap for each that was lost, and
    none that a fault has made."""
    reader = RunReader.open(folder)
    assert reader.sealed and tuple(item.label for item in reader.acknowledged()) == LABELS
    for item in reader.acknowledged():
        blocks = list(reader.blocks(item))
        time = np.concatenate([block.time for block in blocks])
        for name, turned in sensor.felt.items():
            felt = turned if item.label == "turning" else 0.0
            away = np.abs(np.concatenate([block.channels[name] for block in blocks]) - felt)
            strange = int(np.sum(away >= sensor.within))
            assert not strange, f"{item.label}: {strange} samples that nobody should feel"
        assert np.all(np.diff(time) > 0), f"{item.label}: time runs backwards"
        assert time[-1] - time[0] < DWELL * 1.02
    for event in events(folder):
        if event["event"] == "segment":
            frames = event["frames"]
            assert frames["received"] == sum(part["rows"] for part in event["parts"])
            assert frames["received"] + frames["lost"] == round(DWELL * RATE), event["label"]
