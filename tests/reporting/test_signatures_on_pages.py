"""Electronic signatures and the code of the seal, as pages print them: a reader sees who signed what, when, with which key, and whether it
holds. The code is read from the picture of the page in a browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import certificate_example as example
import pytest
from printed_sheets import printed_sheets
from qr_reading import read_code

from planrunner.reporting.context import PrintedSignature, ReportContext
from planrunner.reporting.view import render_report
from tests.browser import chromium, opened, overhang

SEAL = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
KEY = "SHA256:c/uK6lmnGypybD4ytb/YirfbWnjtt7/VnxkkEDyxKu0"
SIGNED = (
    PrintedSignature("recorded", "virtual", "2026-03-02T09:11:07+00:00", KEY, (), "valid", "virtual"),
    PrintedSignature("reviewed", "Anna <b>Example</b>", "2026-03-02T10:00:01+00:00", KEY, (1,), "valid", "anna"),
    PrintedSignature(
        "released", "Ben Example", "2026-03-03T08:30:59.123+00:00", KEY, (1, 2), "invalid", "", "seal.json differs"
    ),
    PrintedSignature("approved", "Carla", "2026-03-04T08:00:00+00:00", KEY, (2,), "unknown", "", "no key ring"),
)
PAGES = ("report.html", "certificate.html", "certificate.zh.html")


def context() -> ReportContext:
    return replace(example.context(), seal=SEAL, signatures=SIGNED)


@pytest.mark.parametrize("name", PAGES)
def test_pages_print_name_meaning_time_key_and_validity(name: str) -> None:
    page = render_report(context(), name)
    words = {
        "certificate.zh.html": ("由试验台记录", "已审核", "已放行", "已批准", "有效", "无效", "未验证", "电子签名"),
    }.get(name, ("recorded", "reviewed", "released", "approved", "valid", "invalid", "not verified", "ignatures"))
    for text in (*words, "2026-03-02 10:00:01", "2026-03-03 08:30:59", KEY, "seal.json differs", "Ben Example"):
        assert text in page, text
    assert "Anna &lt;b&gt;Example&lt;/b&gt;" in page and "<b>Example" not in page


def test_the_text_report_prints_signatures() -> None:
    text = render_report(context(), "summary.md")
    assert "| released | Ben Example | 2026-03-03 08:30:59 | INVALID: seal.json differs | analysis 1, 2 |" in text


def test_pages_without_signatures_have_no_section() -> None:
    for name in (*PAGES, "summary.md"):
        page = render_report(replace(context(), signatures=()), name)
        assert KEY not in page and "## Signatures" not in page and 'id="signatures"' not in page


@pytest.mark.slow
def test_the_code_on_pages_is_the_digest_of_the_seal(tmp_path: Path) -> None:
    with chromium() as browser:
        shown: tuple[tuple[str, int, Literal["light", "dark"], str], ...] = (
            ("certificate.html", 390, "light", SEAL),
            ("certificate.html", 1200, "dark", SEAL[:-1] + "9"),
            ("report.html", 1200, "light", SEAL),
        )
        for name, width, scheme, seal in shown:
            path = tmp_path / name
            path.write_text(render_report(replace(context(), seal=seal), name), encoding="utf-8")
            with opened(browser, path.as_uri(), scheme, width) as page:
                for media in ("screen", "print"):
                    page.emulate_media(media=media)
                    code = page.locator("svg.seal-code").screenshot()
                    assert read_code(code) == f"planrunner:seal:sha256:{seal}"
                page.emulate_media(media="screen")
                assert overhang(page) <= 0


def test_signatures_are_printed(tmp_path: Path) -> None:
    pages = printed_sheets(render_report(context(), "certificate.html"), tmp_path)
    printed = " ".join(pages)
    for text in ("Ben Example", "released", "invalid", "2026-03-02 10:00:01"):
        assert text in printed
