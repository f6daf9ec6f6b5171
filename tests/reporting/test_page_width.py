"""In a browser at a phone's width nothing sticks out of the page. Skipped where there is no Chromium."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping
from html import escape
from pathlib import Path

import certificate_example
import pytest
import reporting_example as example
from diagnosis_example import diagnosis

from planrunner.reporting.diagnosis_page import DiagnosisContext, render_page
from planrunner.reporting.difference_page import render_difference
from planrunner.reporting.show_page import ShowContext, render_show
from planrunner.reporting.view import render_report
from planrunner.review.compared import Compared
from planrunner.tasks.check import Document
from planrunner.tasks.diff import compare_plans

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
OUTER = """<!DOCTYPE html><body>{frames}<script>
addEventListener("load", () => {{
  document.body.dataset.probe = [...document.querySelectorAll("iframe")].map((inner) =>
    inner.contentWindow.innerWidth + " " + inner.contentDocument.documentElement.scrollWidth).join(",");
}})</script>"""
FRAME = '<iframe style="width:{width}px;height:900px;border:0" srcdoc="{page}"></iframe>'
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars", "--dump-dom",
)  # fmt: skip


def widths(pages: Mapping[str, str], width: int, folder: Path) -> dict[str, tuple[int, int]]:
    """(window, content) widths in px of each page, as one browser lays them out in frames, which may be narrower than a window."""
    assert BROWSER is not None
    file = folder / "page.html"
    frames = "".join(FRAME.format(width=width, page=escape(page)) for page in pages.values())
    file.write_text(OUTER.format(frames=frames), encoding="utf-8")
    command = [BROWSER, *OPTIONS, f"--user-data-dir={folder / 'profile'}", "--window-size=1000,1000", file.as_uri()]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=90)
    except (OSError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"the browser does not start here: {type(error).__name__}")
    found = re.search(r'data-probe="([\d ,]+)"', done.stdout)
    if found is None:
        pytest.skip("the browser gives no page here")
    probed = [tuple(map(int, one.split())) for one in found[1].split(",")]
    return {name: (window, content) for name, (window, content) in zip(pages, probed, strict=True)}


def compared_example() -> Compared:
    """Of a shipped plan with another orientation, another dwell and a long label."""
    text = (Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml").read_bytes()
    other = text.replace(b"T1: {x: north, y: west, z: up}", b"T1: {x: north, y: up}").replace(b"2 min", b"1 min")
    other = other.replace(b"        V3:", b"        " + b"V" * 60 + b":")
    return compare_plans(Document(text, "before.yaml"), Document(other, f"{'after' * 30}.yaml"))


PAGES = {
    "report": lambda: render_report(example.context(), "report.html"),
    "show": lambda: render_show(ShowContext("Plan", example.schedule(), designs={"drift": example.design()})),
    "certificate": lambda: render_report(certificate_example.context(), "certificate.html"),
    "certificate in Chinese": lambda: render_report(certificate_example.context(), "certificate.zh.html"),
    "diagnosis": lambda: render_page(DiagnosisContext("Plan", diagnosis("pair"))),
    "difference": lambda: render_difference(compared_example()),
    "long words": lambda: render_report(
        example.context(title="W" * 200, run_information={"n" * 60: "v" * 300}, warnings=("w" * 300,)), "report.html"
    ),
}


WIDE = "what sticks out"


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, int]]:
    if BROWSER is None:
        pytest.skip("no Chromium here")
    pages = {name: make() for name, make in PAGES.items()}
    pages[WIDE] = "<!DOCTYPE html><body><div style='width: 700px'>x</div></body>"
    return widths(pages, 390, tmp_path_factory.mktemp("browser"))


@pytest.mark.parametrize("name", PAGES)
def test_nothing_sticks_out_at_a_phones_width(name: str, measured: dict[str, tuple[int, int]]) -> None:
    window, content = measured[name]
    assert window == 390
    assert content <= window


def test_the_probe_sees_what_sticks_out(measured: dict[str, tuple[int, int]]) -> None:
    assert measured[WIDE][1] >= 700
