"""Analyses stored by tests, as those that `report` and `run` store from the data that they read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from planrunner.archive.analyses import StoredAnalysis
from planrunner.archive.analyses import add_analysis as add
from planrunner.archive.run_reader import RunReader


def add_analysis(run: Path, files: Mapping[str, bytes]) -> StoredAnalysis:
    """Adds an analysis of the data in a run folder. files: maps each file name to its content."""
    reader = RunReader.open(run)
    return add(reader.folder, files, reader.basis)
