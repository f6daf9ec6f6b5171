"""Printed by a browser, every page of a certificate carries its number, its own number and how many there are. Skipped without them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import certificate_example as example
import pytest
from printed_sheets import printed_sheets

from planrunner.reporting.view import render_report


@pytest.mark.parametrize(("name", "end"), [("certificate.html", "End of calibration"), ("certificate.zh.html", "结束")])
def test_number_and_count_on_every_page(name: str, end: str, tmp_path: Path) -> None:
    told = {**example.TOLD, "opinions": "A long opinion. " * 200}
    page = render_report(replace(example.context(), certificate=replace(example.FACTS, told=told)), name)
    pages = printed_sheets(page, tmp_path)
    assert len(pages) > 2
    for place, text in enumerate(pages, 1):
        assert text.count("2026-0117") >= 2, "at the top, for every browser, and at the bottom"
        assert f"{place}/{len(pages)}" in text.replace(" ", "")
    assert end in pages[-1] and not any(end in text for text in pages[:-1])
