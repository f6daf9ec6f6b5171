"""The certificate shows what ISO/IEC 17025:2017 lists, clause by clause; what nobody stated is marked; nothing of it runs."""

from __future__ import annotations

import re
from dataclasses import replace

import certificate_example as example
import numpy as np
import pytest
import reporting_example
from test_report_page import NAMESPACES, read

from planrunner.base.said import Said
from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.reporting.certificate import certificate_view, css_string
from planrunner.reporting.certificate_requirements import ASKED
from planrunner.reporting.context import CertificateFacts
from planrunner.reporting.view import render_report

# Clause → what must stand on the page; the texts of told information are those of the example.
CLAUSES = {
    "7.8.2.1 a": ["Calibration certificate"],
    "7.8.2.1 b": ["Example laboratory", "1 Example Street, Example Town"],
    "7.8.2.1 c": ["Place of calibration Hall 3 of the customer"],
    "7.8.2.1 d": ["Certificate number 2026-0117", "End of calibration certificate 2026-0117"],
    "7.8.2.1 e": ["Customer ‡ The customer", "Contact of the customer ‡ 2 Example Street"],
    "7.8.2.1 f": ["Optimal eight-position calibration of a flexure gyro", "9f2c4e" * 10 + "aabb", "Procedure 12, issue 4"],
    "7.8.2.1 g": ["Flexure gyro, example type", "FG-0007, asset 31", "No visible damage"],
    "7.8.2.1 h": ["Date of receipt 2026-02-27"],
    "7.8.2.1 i": ["Date of calibration 2026-03-01 – 2026-03-02"],
    "7.8.2.1 j": ["Date of issue 2026-03-05"],
    "7.8.2.1 k": ["One of a lot of ten, procedure 3"],
    "7.8.2.1 l": ["The results relate only to the item that was calibrated"],
    "7.8.2.1 m": ["4.271 0.048 deg/h 4.30 2", "2.811 0.060 deg/h/g 4.30 2"],
    "7.8.2.1 n": ["P8 was held for 3 min", "Segment P3 is shorter than planned. cut short", "Segment P5 was recorded again",
                  "A fault interrupted the run. the table did not answer"],
    "7.8.2.1 o": ["Authorised by N. N., head of laboratory"],
    "7.8.2.1 p": ["traditional (flexure_gyro_static) †", "† Results from an external provider: Another laboratory"],
    "7.8.2 note": ["shall not be reproduced except in full without the approval"],
    "7.8.2.2": ["Information supplied by the customer. The laboratory is not responsible for it.",
                "and that can affect the validity of the results: Nominal scale factor of the data sheet", "as it was received"],
    "7.8.4.1 a": ["coverage factor k", "coverage probability of approximately 95 %", "± U"],
    "7.8.4.1 b": ["Ambient temperature 23 degC", "Chamber temperature 25 °C"],
    "7.8.4.1 c": ["International System of Units (SI)", "Earth rate from the conventional value", "survey 2026-1 2026-02-10",
                  "RT-0042 / 2026-117 2026-03-01 2027-03-01 Accredited laboratory"],
    "7.8.4.1 d": ["Torquer gain trimmed", "Before adjustment", "20260228T100000Z-eight-9f9f"],
    "7.8.4.3": ["Calibration interval, as agreed with the customer: 12 months"],
    "7.8.6.2": ["Data sheet 7, issue 2", "≥ -5, ≤ 5 deg/h", "conforms", "does not conform", "JCGM 106:2012, 8.3.2", "42.0 %"],
    "7.8.7": ["This section is an opinion", "The drift is typical of the type"],
    "7.8.8": ["Amendment to calibration certificate 2026-0099", "The customer's name was wrong", "Corrected after the run: customer"],
}  # fmt: skip


def words(page: str) -> str:
    """The page's text as a reader sees it."""
    return " ".join(" ".join(read(re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)).words).split())


@pytest.fixture(scope="module")
def page() -> str:
    return render_report(example.context(), "certificate.html")


@pytest.mark.parametrize("clause", CLAUSES)
def test_every_clause_has_its_place(page: str, clause: str) -> None:
    text = words(page)
    for expected in CLAUSES[clause]:
        assert expected in text, expected


def test_whatever_is_asked_for_is_shown(page: str) -> None:
    """Every recognised name's text appears, but those that choose what is shown."""
    text = words(page)
    for item in ASKED:
        if item.name not in ("external_estimates", "certified_estimates", "date_issued"):
            assert example.TOLD[item.name] in text, item.name


def test_results_before_and_after_stand_side_by_side_with_the_same_unit() -> None:
    rows = certificate_view(example.context())["results"][0]["rows"]
    # D_X_F: u = 0.0112 deg/h with 2 degrees of freedom, k = 4.3027, U = 0.0482; before the adjustment u is twice as large.
    row = next(row for row in rows if row["name"] == "D_X_F")
    assert (row["value"], row["expanded"], row["unit"], row["factor"]) == ("4.271", "0.048", "deg/h", "4.30")
    assert (row["before"], row["before_expanded"]) == ("4.271", "0.096")
    assert [one["has_before"] for one in certificate_view(example.context())["results"]] == [True, False]
    single = certificate_view(example.context(before={}))
    assert not single["has_before"]
    assert "Before adjustment" not in words(render_report(example.context(before={}, told={}), "certificate.html"))


def test_a_heading_before_stands_within_half_a_turn_of_the_one_after() -> None:
    """359.95 deg before and 0.10 deg after differ by 0.15 deg, as the eye reads them side by side."""
    made = [
        Estimate("drift", "test", (Coefficient("heading", value, "deg", 0.005, period=360.0),), np.eye(1))
        for value in (0.10, 359.95)
    ]
    shown = certificate_view(replace(example.context(before={"drift": made[1]}), estimates=(made[0],)))
    (row,) = shown["results"][0]["rows"]
    assert (float(row["value"]), float(row["before"].replace("−", "-"))) == (0.1, -0.05)


def test_conformity_names_rule_guard_band_and_risk() -> None:
    met, failed = certificate_view(example.context())["conformity"]
    assert (met["rule"], met["guard"], met["probability"], met["wrong"]) == ("guarded", "0.048", "> 99.9 %", "< 0.1 %")
    assert (failed["verdict"], failed["probability"], failed["wrong"]) == ("fail", "42.0 %", "42.0 %")
    text = words(render_report(example.context(), "certificate.html"))
    assert "8.2): the item conforms" not in text, "only the rules that were used are explained"
    # U of 95 % leaves 2.5 % beyond either limit.
    assert "1 times the expanded uncertainty U for a coverage probability of 95 %." in text
    assert "lies beyond a given limit is then at most 2.5 %" in text
    assert "the global risk of the consumer is 1.2 % and that of the producer 3.4 %" in text


def test_a_narrow_guard_band_promises_no_risk() -> None:
    context = example.context()
    narrow = tuple(replace(one, guard_factor=0.5, coverage=0.9) for one in context.limits)
    text = words(render_report(replace(context, limits=narrow), "certificate.html"))
    assert "0.5 times the expanded uncertainty U for a coverage probability of 90 %" in text
    assert "lies beyond a given limit" not in text


def test_only_the_certified_estimates_are_shown() -> None:
    text = words(render_report(example.context(told={"certified_estimates": "traditional"}), "certificate.html"))
    assert "traditional (flexure_gyro_static)" in text
    assert "drift (flexure_gyro_static)" not in text
    assert "Statement of conformity" not in text, "the limits are on drift"


def test_without_opinions_interval_or_amendment_the_page_has_none() -> None:
    text = words(render_report(example.context(told={}), "certificate.html"))
    for absent in ("opinion", "interval", "Amendment", "Another laboratory"):
        assert absent not in text
    assert "According to the information supplied, no result comes from an external provider." in text


def test_what_nobody_stated_is_marked() -> None:
    nothing = reporting_example.context(certificate=CertificateFacts("run-1"))
    page = render_report(nothing, "certificate.html")
    missing = re.findall(r"<dt>([^<]*)(?:<sup>.</sup>)?</dt><dd><span class=\"lacking\">not stated</span></dd>", page)
    assert missing == [
        "Customer", "Contact of the customer", "Item", "Identification of the item", "Condition of the item", "Date of receipt",
        "Date of calibration", "Date of issue", "Place of calibration", "Digest of the plan (SHA-256)", "Conditions", "Authorised by",
        "Date of issue",
    ]  # fmt: skip
    assert 'class="lacking"' not in render_report(
        example.context(references=example.FACTS.references[:2]), "certificate.html"
    )


def test_an_instrument_without_calibration_is_marked(page: str) -> None:
    assert "chamber Maker, TC-1 not stated" in words(page)


def test_a_simulated_run_is_called_so() -> None:
    page = words(render_report(example.context(simulated=True), "certificate.html"))
    assert "Simulated: not a calibration" in page
    assert "traceable to the International" not in page
    assert "played back" in words(render_report(example.context(replayed=True), "certificate.html"))
    assert "Simulated" not in words(render_report(example.context(), "certificate.html"))


@pytest.mark.parametrize("name", ["certificate.html", "certificate.zh.html"])
def test_text_from_anywhere_is_text_and_nothing_is_loaded(name: str) -> None:
    bad = "<script>alert(1)</script>\"'\\</style>&{{ 7*7 }} %(x)s %s"
    facts = replace(
        example.FACTS, laboratory=dict.fromkeys(example.FACTS.laboratory, bad), told=dict.fromkeys(example.TOLD, bad),
        corrected={bad: bad}, conditions=((Said(bad), bad),), events=(("fault", bad, bad), ("rejected", bad, bad)),
        references=(replace(example.FACTS.references[1], name=Said(bad), identity=bad, certificate=bad),),
    )  # fmt: skip
    told = {**facts.told, "certified_estimates": "", "external_estimates": ""}
    page = render_report(reporting_example.context(title=bad, certificate=replace(facts, told=told)), name)
    reader = read(page)
    assert "script" not in reader.tags
    assert "49" not in " ".join(reader.words).split()
    assert page.count("</style>") == 1
    assert set(re.findall(r"https?://[^\"'\s<>)]*", page)) <= NAMESPACES
    assert not re.search(r"@import|\bsrc=|url\((?!#)", page)
    assert bad.replace(" ", "") in "".join(reader.words).replace(" ", "")


def test_number_as_a_string_of_the_style_sheet() -> None:
    assert css_string("A-1") == "A\\00002d1"
    assert css_string('"}') == "\\000022\\00007d"
    assert css_string("编号") == "\\007f16\\0053f7"
