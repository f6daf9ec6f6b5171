"""The HTML report: what it shows, that nothing in it runs or loads, that it is the same every time."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import reporting_example as example

from planrunner.base.said import Said
from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.estimators.tables import Role, Table, TableColumn
from planrunner.reporting.budgets import budget_views
from planrunner.reporting.context import ReportContext
from planrunner.reporting.show_page import ShowContext, render_show
from planrunner.reporting.verdict import Headline
from planrunner.reporting.view import coefficient_row, render_report, table_view

VOID = {"meta", "br", "hr", "img", "link", "input", "col", "wbr"}
NAMESPACES = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


class Reader(HTMLParser):
    """Collects tags, ids and text; fails on tags that do not nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.anchors: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            assert not name.startswith("on"), (tag, name)
            if name == "id":
                self.ids.append(value or "")
            if name in ("href", "xlink:href"):
                self.anchors.append(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert not reader.open
    return reader


@pytest.fixture(scope="module")
def page() -> str:
    return render_report(example.context(), "report.html")


@pytest.fixture(scope="module")
def show() -> str:
    context = ShowContext("Plan", example.schedule(), designs={"drift": example.design()})
    return render_show(context)


def test_it_shows_what_was_run_and_what_came_out(page: str) -> None:
    text = " ".join(" ".join(read(page).words).split())
    for expected in (
        "1 of 2 limits is not met",
        "FG-0417",
        "WO-2291",
        "virtual table",
        "39.9800° N",
        "0.201146",
        "0.000013",
        "within ±5 deg/h",
        "Residuals per position",
        "Correlation coefficients × 100",
        "Standard uncertainties by either basis",
        "The chamber reached 25.6 degC in P7",
        "5be840" * 10,
        "x up, y north, z west",
    ):
        assert expected in text, expected


def test_both_pages_are_well_formed_with_distinct_ids_and_inner_links(page: str, show: str) -> None:
    for text in (page, show):
        reader = read(text)
        assert len(set(reader.ids)) == len(reader.ids)
        for anchor in reader.anchors:
            assert anchor.startswith("#")
            assert anchor[1:] in reader.ids


def test_both_pages_load_nothing(page: str, show: str) -> None:
    for text in (page, show):
        assert set(re.findall(r"https?://[^\"'\s<>)]*", text)) <= NAMESPACES
        assert not re.search(r"@import|\bsrc=|url\((?!#)|[\"'(=]//", text)
        assert not {"script", "link", "iframe", "object", "embed", "img", "base"} & set(read(text).tags)


def test_the_same_context_gives_the_same_bytes(page: str, show: str) -> None:
    assert render_report(example.context(), "report.html") == page
    assert render_show(ShowContext("Plan", example.schedule(), designs={"drift": example.design()})) == show


def hostile_context() -> ReportContext:
    bad = "<script>alert(1)</script>\"'&{{ 7*7 }}"
    original = example.estimate()
    coefficients = tuple(replace(item, name=bad, description=Said(bad), unit=bad) for item in original.coefficients[:2])
    plot = replace(
        original.plots[0], title=bad, x_title=bad, y_title=bad, x=(bad,), series={bad: (1.0,)}, uncertainties={}
    )
    estimate = Estimate(
        bad, bad, coefficients, np.eye(2), settings={bad: bad},
        tables=(Table(bad, (TableColumn(bad, unit=bad),), ((bad,),)),), plots=(plot,), notes=(Said(bad),),
        warnings=(Said(bad),), segments=(bad,),
    )  # fmt: skip
    limit = replace(example.context().limits[0], quantity=bad, requirement=bad, reason=bad, unit=bad)
    segment = example.context().segments[0]
    segment = replace(segment, segment=replace(segment.segment, label=bad, orientation=bad), remark=bad)
    return example.context(
        title=bad, description=Said(bad), run_information={bad: bad}, bench={bad: bad}, instruments={bad: {bad: bad}},
        estimates=(estimate,), limits=(limit,), segments=(segment,), warnings=(bad,), notes=(bad,), provenance={bad: bad},
    )  # fmt: skip


def test_text_from_anywhere_is_text() -> None:
    context = hostile_context()
    page = render_report(context, "report.html")
    reader = read(page)
    assert "script" not in reader.tags
    assert "49" not in " ".join(reader.words).split()
    shown = render_show(ShowContext(context.title, example.schedule(), context.description, facts=context.bench))
    assert "script" not in read(shown).tags
    assert "<script" not in render_report(context, "summary.md")


def test_headline_says_how_many() -> None:
    context = example.context()
    assert context.headline.kind == "fail"
    both = tuple(replace(limit, verdict="pass") for limit in context.limits)
    met = replace(context, limits=both, warnings=(), estimates=(example.estimate(),))
    assert met.headline == Headline("pass", "Passed: both limits are met")
    assert replace(context, limits=()).headline.kind == "none"
    broken = replace(met, failures={"drift": "two segments are missing"}).headline
    assert broken.kind == "fail"
    assert broken.detail == "drift: two segments are missing"


def test_warnings_stand_beside_the_verdict() -> None:
    """Those of the run and those of every estimate; a verdict with warnings is not shown as one without."""
    context = example.context()
    both = tuple(replace(limit, verdict="pass") for limit in context.limits)
    warned = replace(example.estimate(), warnings=(Said("the model does not fit"), Said("samples were lost")))
    estimates = (warned, replace(example.estimate("other"), warnings=(Said("few segments"),)))
    met = replace(context, limits=both, estimates=estimates, warnings=("a fault",)).headline
    assert met.kind == "warned"
    assert met.text.startswith("Passed, with 4 warnings")
    one = replace(context, limits=both[:1], estimates=(), warnings=("a fault",)).headline
    assert one.text.startswith("Passed, with 1 warning:")
    assert (
        "No limits were set (1 warning)"
        in replace(context, limits=(), estimates=(), warnings=("a fault",)).headline.text
    )
    assert "with 4 warnings" in replace(context, estimates=estimates, warnings=("a fault",)).headline.text


def test_expanded_uncertainty_uses_students_factor() -> None:
    # Two-sided 95 % points of Student's t: 12.71 (1), 4.303 (2), 2.228 (10), 1.960 (normal); JCGM 100:2008, table G.2.
    for freedom, factor in ((1.0, "12.71"), (2.0, "4.30"), (10.0, "2.23"), (math.inf, "1.96")):
        row = coefficient_row(Coefficient("K", 10.0, "1", 1.0, freedom))
        assert row["factor"] == factor
    row = coefficient_row(Coefficient("K", 1.23456, "deg/h", 0.0112, 2.0))
    assert (row["value"], row["expanded"], row["standard"]) == ("1.235", "0.048", "0.011")


def test_numbers_in_tables_are_rounded_by_the_uncertainty_to_their_right() -> None:
    table = Table(
        "t",
        (
            TableColumn("name"),
            TableColumn("rate", Role.NUMBER, "deg/s"),
            TableColumn("value", Role.VALUE, "V"),
            TableColumn("spread", Role.STANDARD_UNCERTAINTY),
            TableColumn("freedom", Role.DEGREES_OF_FREEDOM),
            TableColumn("interval", Role.EXPANDED_UNCERTAINTY),
            TableColumn("ratio", Role.VALUE),
            TableColumn("smaller", Role.SHARE),
        ),
        (
            ("a", 12.3456, 1.23456789, 0.0123456, 2.0, 0.0531, 2.3571234, 0.9254),
            ("b", 0.0, 0.0, 0.0, math.inf, 0.0, 1.0, None),
        ),
    )
    view = table_view(table)
    assert view["rows"] == [
        ["a", "12.346", "1.235", "0.012", "2", "0.053", "2.3571", "92.5 %"],
        ["b", "0", "0", "0", "∞", "0", "1", "–"],
    ]
    assert [column["title"] for column in view["columns"]][:3] == ["name", "rate [deg/s]", "value [V]"]
    assert [column["numeric"] for column in view["columns"]] == [False, *[True] * 7]


def test_no_title_changes_how_a_column_is_shown() -> None:
    """Each role with titles that read like every other role: the cells stay."""
    titles = ("value", "u", "U 95 %", "± U", "dof", "degrees of freedom", "share", "unit", "")
    for role in Role:
        columns = [
            (TableColumn(title, role), TableColumn("right of it", Role.STANDARD_UNCERTAINTY)) for title in titles
        ]
        shown = [table_view(Table("t", pair, ((1.23456789, 0.0123),))) for pair in columns]
        assert all(one["rows"] == shown[0]["rows"] for one in shown)
        assert all(one["columns"][0]["numeric"] == shown[0]["columns"][0]["numeric"] for one in shown)


def test_empty_report_is_a_page_too() -> None:
    page = render_report(ReportContext("Nothing yet"), "report.html")
    assert "Nothing was recorded" in page
    assert "No limits were set" in render_report(ReportContext("Nothing yet"), "summary.md")


def test_headline_coefficients_come_first_and_the_others_are_kept() -> None:
    original = replace(example.estimate(), headline=("D_X_F", "D_Y_F", "SF_X", "SF_Y"))
    page = render_report(example.context(estimates=(original,)), "report.html")
    text = " ".join(read(page).words)
    assert text.index("Other coefficients") > text.index("D_X_F")
    assert text.index("Other coefficients") < text.rindex("epsilon")
    assert "Correlations of 4 coefficients" in page


def test_budgets_show_every_input_with_its_share_and_source() -> None:
    """u = sqrt(0.0112² + 0.0036² + 0.0008²) = 0.011791 deg/h; shares 90.2 %, 9.3 % and 0.5 %; U = 2.59 · 0.011791 = 0.0305."""
    (first, second) = budget_views(example.estimate())
    assert (first["standard"], first["freedom"], first["factor"], first["expanded"]) == (
        "0.012",
        "4.9",
        "2.59",
        "0.031",
    )
    assert [line["share"] for line in first["lines"]] == ["90.2 %", "9.3 %", "0.5 %", "–"]
    position = first["lines"][1]
    assert position["quantity"] == "table position (8 ×)"
    assert (position["standard"], position["unit"], position["distribution"]) == ("3.0", "arcsec", "rectangular")
    assert (position["sensitivity"], position["contribution"], position["freedom"]) == ("0.0012", "0.0036", "∞")
    assert position["source"] == "table, asset RT-0042, certificate RT-0042 / 2026-117, 2026-03-01"
    assert [line["added"] for line in first["lines"]] == [True, True, True, False]
    assert second["coefficient"] == "epsilon"
    page = render_report(example.context(), "report.html")
    text = " ".join(" ".join(read(page).words).split())
    assert "D_X_F: u = 0.012 deg/h, ν = 4.9" in text
    assert "in the scatter" in text


def test_only_budgets_of_headline_coefficients_are_open() -> None:
    narrow = replace(example.estimate(), headline=("epsilon",))
    page = render_report(example.context(estimates=(narrow,)), "report.html")
    parts = re.findall(r'<details class="budget"( open)?>\s*<summary>(\w+):', page)
    assert parts == [(" open", "epsilon"), ("", "D_X_F")]
    assert "Uncertainty budget of epsilon" in render_report(example.context(estimates=(narrow,)), "summary.md")
    assert "Uncertainty budget of D" not in render_report(example.context(estimates=(narrow,)), "summary.md")


def test_no_budget_where_only_the_data_contribute() -> None:
    lonely = replace(example.budgets()[0], lines=example.budgets()[0].lines[:1])
    assert budget_views(replace(example.estimate(), budgets=(lonely,))) == []


def test_limits_show_guard_band_and_risks() -> None:
    met = replace(
        example.context().limits[0], guard_band=0.0241, guard_factor=0.5, probability=0.987, false_decision=0.013,
        consumer_risk=0.002, producer_risk=0.031,
    )  # fmt: skip
    text = " ".join(" ".join(read(render_report(example.context(limits=(met,)), "report.html")).words).split())
    assert "guarded (w = 0.5·U) global risks: consumer 0.2 %, producer 3.1 % 0.024 98.7 % 1.3 %" in text
    simple = replace(met, rule="simple", guard_band=0.0, consumer_risk=math.nan, producer_risk=math.nan)
    text = " ".join(" ".join(read(render_report(example.context(limits=(simple,)), "report.html")).words).split())
    assert "simple 0 98.7 % 1.3 %" in text
