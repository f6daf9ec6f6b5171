"""Printed by a browser, every page of a certificate carries its number, its own number and how many there are. Skipped without them."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import certificate_example as example
import pytest
from test_page_width import BROWSER, OPTIONS

from planrunner.reporting.report import render_report

TEXT = shutil.which("pdftotext")


@pytest.mark.skipif(BROWSER is None or TEXT is None, reason="no Chromium or no pdftotext here")
@pytest.mark.parametrize(("name", "end"), [("certificate.html", "End of calibration"), ("certificate.zh.html", "结束")])
def test_number_and_count_on_every_page(name: str, end: str, tmp_path: Path) -> None:
    assert BROWSER is not None and TEXT is not None
    told = {**example.TOLD, "opinions": "A long opinion. " * 200}
    page, pdf = tmp_path / name, tmp_path / "printed.pdf"
    page.write_text(
        render_report(replace(example.context(), certificate=replace(example.FACTS, told=told)), name), "utf-8"
    )
    options = [option for option in OPTIONS if option not in ("--dump-dom", "--hide-scrollbars")]
    command = [
        BROWSER,
        *options,
        f"--user-data-dir={tmp_path / 'profile'}",
        "--no-pdf-header-footer",
        f"--print-to-pdf={pdf}",
    ]
    try:
        subprocess.run([*command, page.as_uri()], capture_output=True, timeout=90, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"the browser does not start here: {type(error).__name__}")
    if not pdf.is_file():
        pytest.skip("the browser prints nothing here")
    printed = subprocess.run([TEXT, "-layout", str(pdf), "-"], capture_output=True, text=True, check=True).stdout
    pages = printed.removesuffix("\f").split("\f")
    assert len(pages) > 2
    for place, text in enumerate(pages, 1):
        assert text.count("2026-0117") >= 2, "at the top, for every browser, and at the bottom"
        assert f"{place}/{len(pages)}" in text.replace(" ", "")
    assert end in pages[-1] and not any(end in text for text in pages[:-1])
