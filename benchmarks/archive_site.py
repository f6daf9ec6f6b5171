"""Measures the site of an archive: the time to build it, its size, and the time until a browser shows its first page.

The runs are synthetic, and their reports do not exist. The time of the first page is the time that the browser measures from
the beginning of the navigation to the heading; the browser is already open. Without Chromium, this time is not measured.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measuring import Figures
from planrunner.night.history.index import Index
from planrunner.night.site import build_site
from tests.browser import CHROMIUM, OPTIONS, PATIENCE
from tests.night.synthetic_archive import filled


@dataclass(frozen=True, slots=True)
class Size:
    """Number of runs in the archive, and number of times that the page is opened."""

    runs: int
    visits: int


FULL, SMALL = Size(10_000, 7), Size(50, 1)


def first_pages(page: Path, visits: int) -> list[float]:
    """Returns the time from the start of each navigation to the heading of the page, s. Each navigation uses a new browser
    profile."""
    from playwright.sync_api import sync_playwright

    found = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(OPTIONS), timeout=PATIENCE)
        for _ in range(visits):
            context = browser.new_context()
            opened = context.new_page()
            opened.add_init_script(
                "new MutationObserver((_, self) => { if (document.querySelector('h1')) "
                "{ self.disconnect(); globalThis.shownAfter = performance.now(); } })"
                ".observe(document, { childList: true, subtree: true });"
            )
            opened.goto(page.as_uri())
            opened.wait_for_function("globalThis.shownAfter !== undefined", timeout=PATIENCE)
            found.append(opened.evaluate("globalThis.shownAfter") / 1000)
            context.close()
        browser.close()
    return found


def run(size: Size = FULL) -> Figures:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "runs").mkdir()
        with Index.open(folder / "runs", str(folder / "index.sqlite")) as index:
            filled(index, size.runs)
            began = time.perf_counter()
            built = build_site(index, folder / "site")
            seconds = time.perf_counter() - began
        bytes_ = sum(path.stat().st_size for path in (folder / "site").rglob("*") if path.is_file())
        figures: Figures = {
            f"site of {size.runs} runs from their index [s] (target ≤ 60)": seconds,
            "size of the site [MB]": bytes_ / 1e6,
        }
        if CHROMIUM is not None:
            visits = first_pages(built.page, size.visits)
            figures[f"first page, median of {size.visits} visits [s] (target ≤ 1)"] = statistics.median(visits)
            figures["first page, slowest visit [s]"] = max(visits)
        return figures
