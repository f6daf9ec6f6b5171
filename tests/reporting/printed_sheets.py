"""A page as Chromium prints it: the text of each sheet. The test that asks is skipped where there is no Chromium or no pdftotext."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from test_page_width import BROWSER, OPTIONS

TEXT = shutil.which("pdftotext")


def printed_sheets(page: str, folder: Path) -> list[str]:
    """The text of every sheet of `page`, which is HTML."""
    if BROWSER is None or TEXT is None:
        pytest.skip("no Chromium or no pdftotext here")
    file, pdf = folder / "page.html", folder / "printed.pdf"
    file.write_text(page, encoding="utf-8")
    options = [option for option in OPTIONS if option not in ("--dump-dom", "--hide-scrollbars")]
    profile = f"--user-data-dir={folder / 'profile'}"
    command = [BROWSER, *options, profile, "--no-pdf-header-footer", f"--print-to-pdf={pdf}", file.as_uri()]
    try:
        subprocess.run(command, capture_output=True, timeout=90, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"the browser does not start here: {type(error).__name__}")
    if not pdf.is_file():
        pytest.skip("the browser prints nothing here")
    printed = subprocess.run([TEXT, "-layout", str(pdf), "-"], capture_output=True, text=True, check=True).stdout
    return printed.removesuffix("\f").split("\f")
