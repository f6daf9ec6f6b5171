"""In a browser at a phone's width nothing sticks out of the page. Skipped where there is no Chromium."""

from __future__ import annotations

import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import certificate_example
import pytest
import reporting_example as example
from diagnosis_example import diagnosis

from planrunner.reporting.diagnosis_page import DiagnosisContext, render_page
from planrunner.reporting.report import render_report
from planrunner.reporting.show_page import ShowContext, render_show

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
OUTER = """<!DOCTYPE html><body><iframe style="width:{width}px;height:900px;border:0" srcdoc="{page}"></iframe><script>
addEventListener("load", () => {{
  const inner = document.querySelector("iframe");
  const size = inner.contentDocument.documentElement.scrollWidth;
  document.body.dataset.probe = inner.contentWindow.innerWidth + " " + size;
}})</script>"""
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars", "--dump-dom",
)  # fmt: skip


def widths(page: str, width: int, folder: Path) -> tuple[int, int]:
    """(window, content) widths in px as the browser lays the page out in a frame, which may be narrower than a window."""
    assert BROWSER is not None
    file = folder / "page.html"
    file.write_text(OUTER.format(width=width, page=escape(page)), encoding="utf-8")
    command = [BROWSER, *OPTIONS, f"--user-data-dir={folder / 'profile'}", "--window-size=1000,1000", file.as_uri()]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=90)
    except (OSError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"the browser does not start here: {type(error).__name__}")
    found = re.search(r'data-probe="(\d+) (\d+)"', done.stdout)
    if found is None:
        pytest.skip("the browser gives no page here")
    return int(found[1]), int(found[2])


PAGES = {
    "report": lambda: render_report(example.context(), "report.html"),
    "show": lambda: render_show(ShowContext("Plan", example.schedule(), designs={"drift": example.design()})),
    "certificate": lambda: render_report(certificate_example.context(), "certificate.html"),
    "certificate in Chinese": lambda: render_report(certificate_example.context(), "certificate.zh.html"),
    "diagnosis": lambda: render_page(DiagnosisContext("Plan", diagnosis("pair"))),
    "long words": lambda: render_report(
        example.context(title="W" * 200, run_information={"n" * 60: "v" * 300}, warnings=("w" * 300,)), "report.html"
    ),
}


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("name", PAGES)
def test_nothing_sticks_out_at_a_phones_width(name: str, tmp_path: Path) -> None:
    window, content = widths(PAGES[name](), 390, tmp_path)
    assert window == 390
    assert content <= window


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_the_probe_sees_what_sticks_out(tmp_path: Path) -> None:
    assert widths("<!DOCTYPE html><body><div style='width: 700px'>x</div></body>", 390, tmp_path)[1] >= 700
