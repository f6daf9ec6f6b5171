"""The calibration curve of a score: how often those who answered were right, over how sure they were, and how many cases that is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tests.blind.scoring import BINS, Rate

STYLES = {"planrunner": ("o", "#1f5fa8"), "oracle": ("s", "#c46210")}
SHIFT = 0.12  # of a bin, by which those who answered stand beside one another


def curve(figures: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Points with 95 % Wilson intervals, one for each bin that holds a case; below, the cases in each bin."""
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    over, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    over.plot([0, 1], [0, 1], color="0.6", linewidth=1, zorder=1)
    for k, (who, (mark, colour)) in enumerate((w, s) for w, s in STYLES.items() if w in figures):
        found = figures[who]["calibration"]
        bins = found["bins"]
        rates = [Rate(round(item["right"] * item["n"]), item["n"]) for item in bins]
        x = np.array([item["confidence"] for item in bins]) + (k - 0.5) * SHIFT / BINS
        y = np.array([rate.value for rate in rates])
        reach = np.abs(np.array([rate.interval for rate in rates]).T - y)
        label = f"{who}: expected calibration error {found['ece']:.3f}"
        over.errorbar(x, y, reach, fmt=mark, color=colour, markersize=5, linewidth=1.2, label=label)
        below.bar(x + (k - 0.5) * 0.45 / BINS, [rate.n for rate in rates], width=0.4 / BINS, color=colour)
    over.set(ylabel="share that was right, 95 % interval", xlim=(0, 1.02), ylim=(0, 1.02))
    over.legend(loc="upper left", frameon=False)
    below.set(xlabel="probability of what was announced", ylabel="cases", yscale="log")
    return figure


def drawn(score: Path, file: Path) -> None:
    """Reads what `score --json` wrote, writes the curve as SVG, the same bytes each time."""
    figures = json.loads(score.read_text(encoding="utf-8"))["answers"]
    with mpl.rc_context({"svg.hashsalt": "calibration", "svg.fonttype": "path"}):
        curve(figures).savefig(file, format="svg", metadata={"Date": None})
