"""A report of a run that was really carried out, on the virtual bench."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from planrunner.archive.run_reader import RunReader
from planrunner.base.shipped import shipped
from planrunner.estimators.analysis import analyse
from planrunner.execution.stopping import StopRequest
from planrunner.reporting.view import render_report
from planrunner.tasks.check import check_plan
from planrunner.tasks.estimate import report_context, sound_run
from planrunner.tasks.run import start

PLAN = """
planrunner: 1
title: Two rates <about> up
description: >
  A short run.
bench: mine.yaml
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
record: {device_serial: required}
defaults: {settle: 1 s, dwell: 5 s}
segments:
  - for_each:
      orientation:
        P1: {x: up, y: north}
        P2: {x: down, y: north}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    (folder / "short.yaml").write_text(PLAN, encoding="utf-8")
    bench = (shipped("plans") / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    bench = bench.replace("driver: virtual_table", "driver: virtual_table\n    asset: RT-0042")
    bench += "ambient: {temperature: 23 degC, humidity: 45 %}\n"
    (folder / "mine.yaml").write_text(bench, encoding="utf-8")
    sound = check_plan(folder / "short.yaml").sound()
    info = {"device_serial": "FG-<7>"}
    path, _ = start(sound, info=info, runs=folder / "runs", stop=StopRequest(), durability="flushed")
    return path


def test_the_report_says_what_was_run_and_what_it_rests_on(run: Path) -> None:
    reader = RunReader.open(run)
    sound = sound_run(reader)
    recording = reader.recording(sound.schedule)
    results = analyse(sound.plan.estimates, sound.plan.limits, recording, sound.models.site, sound.sensor)
    context = report_context(reader, sound, recording, results, analysis="3", analysed="2026-01-02T03:04:05+00:00")
    assert context.title == "Two rates <about> up"
    assert context.description == "A short run."
    assert context.run_information["device_serial"] == "FG-<7>"
    assert context.instruments["table"] == {**reader.instruments["table"], "asset": "RT-0042"}
    assert context.instruments["gyro"] == reader.instruments["gyro"]
    assert context.bench["ambient temperature"] == "23 degC"
    assert context.bench["ambient humidity"] == "45 %"
    assert context.warnings == ()
    seal = json.loads((run / "seal.json").read_text(encoding="utf-8"))
    assert context.provenance["journal head (SHA-256)"] == seal["journal"]["head"]
    assert context.provenance["plan.yaml (SHA-256)"] == seal["files"]["plan.yaml"]
    assert context.provenance["analysis"] == "3"
    page = render_report(context, "report.html")
    for expected in (
        "FG-&lt;7&gt;",
        "Two rates &lt;about&gt; up",
        seal["journal"]["head"],
        "x up, y north, z west",
        "RT-0042",
    ):
        assert expected in page
    assert render_report(context, "report.html") == page


def test_what_went_wrong_stands_on_top(run: Path) -> None:
    reader = RunReader.open(run)
    sound = sound_run(reader)
    recording = reader.recording(sound.schedule)
    cut = replace(reader, seal=None)
    results = replace(analyse({}, (), recording, sound.models.site, sound.sensor), failures={"drift": "no positions"})
    held = dict(reader.state.acknowledged)
    try:
        reader.state.acknowledged.pop(1)
        context = report_context(cut, sound, recording[:1], results)
    finally:
        reader.state.acknowledged.update(held)
    assert any("1 of 2 planned segments were not recorded" in text for text in context.warnings)
    assert any("not sealed" in text for text in context.warnings)
    page = render_report(context, "report.html")
    assert "Incomplete" in page and "not everything could be estimated" in page
    assert "drift: no positions" in page
