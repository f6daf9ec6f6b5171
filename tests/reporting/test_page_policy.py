"""Every page carries a policy that allows the style in its head and nothing else, and keeps to it."""

from __future__ import annotations

import base64
import hashlib
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from test_page_width import BROWSER, OPTIONS, PAGES

from planrunner.base.findings import Findings
from planrunner.design.study import Pose, Study, Subject
from planrunner.estimators.tables import Plot, Table, TableColumn
from planrunner.reporting.plots import plot_svg
from planrunner.reporting.study_page import render_page

ROOT = Path(__file__).resolve().parents[2]
STUDY = Study(
    Subject("Study </style><script>alert(1)</script>", {"Plan": "p.yaml"}, "p.yaml", Findings()),
    "rates",
    "heading",
    {"fact": "value"},
    (Table("T", (TableColumn("a"),), (("b",),)),),
    ("note",),
    "footer",
    {},
    "",
    plots=(Plot("P", "x", "y", (1.0, 2.0), {"s": (1.0, 2.0)}),),
    poses={"As planned": (Pose("P </style>", np.eye(3), "x up"),)},
)


class Page(HTMLParser):
    """What matters to a policy: the tags in their order, styles, and whatever would run or load something."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[str] = []
        self.policy = ""
        self.style = ""
        self.offences: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        given = dict(attrs)
        if (given.get("http-equiv") or "").lower() == "content-security-policy":
            self.tags[-1] = "policy"
            self.policy = given["content"] or ""
        for name, value in attrs:
            if name == "style" or name.startswith("on") or name in ("src", "action"):
                self.offences.append(f"{tag} {name}")
            if name in ("href", "xlink:href") and not (value or "").startswith("#"):
                self.offences.append(f"{tag} {name}={value}")

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] == "style":
            self.style += data
            self.tags.append("text")


def drawn(name: str) -> str:
    return render_page(STUDY) if name == "study" else PAGES[name]()


@pytest.mark.parametrize(
    "name",
    [
        "study",
        *(pytest.param(name, marks=[pytest.mark.slow] if name in ("report", "long words") else []) for name in PAGES),
    ],
)
def test_a_page_allows_its_style_and_nothing_else(name: str) -> None:
    page = Page(drawn(name))
    value = base64.b64encode(hashlib.sha256(page.style.encode()).digest()).decode()
    rules = dict(rule.strip().split(" ", 1) for rule in page.policy.split(";"))
    assert rules == {
        "default-src": "'none'",
        "style-src": f"'sha256-{value}'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    assert len(page.style) > 1000
    assert page.tags.count("style") == 1
    assert page.tags.index("policy") < page.tags.index("style") < page.tags.index("title")
    assert not {"script", "link", "iframe", "object", "embed", "img", "base"} & set(page.tags)
    assert page.offences == []


def test_every_shipped_page_begins_with_its_policy() -> None:
    pages = sorted((ROOT / "templates").glob("*.html.j2"))
    assert len(pages) >= 5
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert text.count("{{ blocks.style(css) }}") == 1, path
        assert "<style" not in text, path


def test_a_label_that_looks_like_a_style_stays_a_label() -> None:
    label = 'a style="fill: red" b'
    svg = plot_svg(Plot("P", label, "y", (1.0, 2.0), {label: (1.0, 2.0)}), "k")
    assert label in svg.replace("&quot;", '"')
    assert not re.search(r"<[^<>]* style=", svg)
    assert "<style" not in svg


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("name", ["study", *PAGES])
def test_a_browser_finds_nothing_against_the_policy(name: str, tmp_path: Path) -> None:
    def told(page: str) -> str:
        file = tmp_path / "page.html"
        file.write_text(page, encoding="utf-8")
        profile = f"--user-data-dir={tmp_path / 'profile'}"
        command = [str(BROWSER), *OPTIONS, "--enable-logging=stderr", profile, file.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, timeout=180)
        assert "</html>" in done.stdout
        return done.stderr

    page = drawn(name)
    assert "Content Security Policy" in told(page.replace("</body>", '<p style="color: red">x</p></body>'))
    assert "Content Security Policy" not in told(page)
