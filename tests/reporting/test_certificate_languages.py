"""Certificates in English and Chinese from one template: catalogues are complete and up to date, and a template stays harmless."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import certificate_example as example
import pytest
from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.frontend import parse_mapping_cfg
from babel.messages.pofile import read_po
from test_report_page import read

from planrunner.error_model.flexure_gyro import output_names, physical_names
from planrunner.estimators.flexure_gyro.tables import descriptions
from planrunner.reporting import language as catalogues
from planrunner.reporting import translated_words
from planrunner.reporting.language import filled, languages, spoken, translations
from planrunner.reporting.templates import ReportError, available, render
from planrunner.reporting.view import render_report

ROOT = Path(__file__).resolve().parents[2]
LOCALES = ROOT / "locales"
PLACE = re.compile(r"%\(\w+\)s|%%")


def catalogue(name: str) -> Catalog:
    return read_po(io.BytesIO((LOCALES / name).read_bytes()))


def messages(found: Catalog) -> dict[str, Any]:
    return {message.id: message for message in found if isinstance(message.id, str) and message.id}


def extracted() -> set[str]:
    with (ROOT / "babel.cfg").open(encoding="utf-8") as file:
        methods, options = parse_mapping_cfg(file)
    return {
        message
        for message in (found[2] for found in extract_from_dir(ROOT, methods, options))
        if isinstance(message, str)
    }


def test_the_catalogues_hold_what_the_templates_say() -> None:
    found = extracted()
    assert len(found) > 100
    for name in ("planrunner.pot", *(f"{language}.po" for language in languages())):
        assert set(messages(catalogue(name))) == found, f"{name}: run `make catalogues` and translate"


@pytest.mark.parametrize("language", languages())
def test_every_message_is_translated_with_its_placeholders(language: str) -> None:
    for text, message in messages(catalogue(f"{language}.po")).items():
        assert message.string, text
        assert not message.fuzzy, text
        assert sorted(PLACE.findall(message.string)) == sorted(PLACE.findall(text)), text
        assert message.string != text, text


def test_chinese_is_there() -> None:
    assert "zh" in languages()
    assert {"certificate.html", "certificate.zh.html"} <= set(available())


# Letters that a Chinese certificate shows: symbols, names of standards and what the example was told, which here is none.
SYMBOLS = {"U", "k", "ν", "SI", "SHA", "JCGM", "GUM", "t", "run"}


def test_a_chinese_page_has_no_english_left() -> None:
    """With everything told in figures, no Latin word is left but symbols, units, names of coefficients and of estimates."""
    told = {name: f"{place}" for place, name in enumerate(example.TOLD)} | {"external_estimates": "traditional"}
    facts = replace(
        example.FACTS, told=told, run="1", before_run="2", corrected={"3": "4"}, plan_digest="5",
        laboratory=dict.fromkeys(example.FACTS.laboratory, "6"),
        references=tuple(replace(item, identity="7", certificate="8", laboratory="9") for item in example.FACTS.references),
        conditions=tuple((name, "10") for name in translated_words.CONDITIONS),
        events=tuple((kind, "11", "12") for kind, _, _ in example.FACTS.events), simulated=False, replayed=True,
    )  # fmt: skip
    context = replace(example.context(), title="13", certificate=facts)
    names_of_all = (*physical_names(), *chain.from_iterable(output_names()))
    words = dict(zip(names_of_all, descriptions(), strict=True))
    estimates = []
    for item in context.estimates:
        coefficients = [replace(one, description=words[one.name], unit="1") for one in item.coefficients]
        estimates.append(replace(item, name="14", estimator="15", warnings=(), coefficients=tuple(coefficients)))
    names = {
        part for item in context.estimates for one in item.coefficients for part in re.split(r"[^A-Za-z]+", one.name)
    }
    limits = tuple(
        replace(limit, rule=rule, unit="1", quantity="16")
        for limit, rule in zip(context.limits, ("simple", "guarded"), strict=True)
    )
    for simulated in (False, True):
        shown = replace(
            context, estimates=tuple(estimates), limits=limits,
            certificate=replace(facts, simulated=simulated, told={**told, "external_estimates": "", "certified_estimates": ""}),
        )  # fmt: skip
        page = render_report(shown, "certificate.zh.html")
        assert '<html lang="zh">' in page
        text = " ".join(read(re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)).words)
        attributes = " ".join(re.findall(r'(?:aria-label|data-before)="([^"]*)"', page))
        left = set(re.findall(r"[A-Za-z]{2,}", text + " " + attributes)) - names - SYMBOLS
        assert left == set()
        assert "校准证书" in text and "包含因子" in text and "计量溯源性" in text and "判定规则" in text


def test_both_languages_hold_the_same_figures_and_dates() -> None:
    english, chinese = (
        re.sub(r"<style>.*?</style>", "", render_report(example.context(), name), flags=re.DOTALL)
        for name in ("certificate.html", "certificate.zh.html")
    )
    figures = [re.findall(r"-?\d[\d.\-/]*", " ".join(read(page).words)) for page in (english, chinese)]
    assert sorted(figures[0]) == sorted(figures[1])
    assert "2026-03-05" in figures[1]


# Abbreviations, names of standards, keys of plans and digits of units that Chinese texts keep; estimators keep the name that plans use.
KEPT = {"IEEE", "Std", "ln", "pool_outputs", "false", "rings", "highest_order", "groups"}


def test_translated_words_have_no_english_left() -> None:
    chinese = translations("zh")
    for text in (*translated_words.DESCRIPTIONS, *translated_words.WARNINGS, *translated_words.ESTIMATORS):
        own = {text} if text in translated_words.ESTIMATORS else set()
        left = set(re.findall(r"[A-Za-z]{2,}(?:_[a-z]+)*", PLACE.sub("", str(chinese[text])))) - KEPT - own
        assert not left, text


def test_sentences_with_names_and_numbers_are_translated() -> None:
    term = spoken("zh")["term"]
    assert term("gyro_x: offset at zero rate") == "gyro_x：零速率时的偏置"
    # The closest of the three messages that fit, not the shortest.
    assert term("x: scale factor along the axis at -40degC") == "x：-40 °C 时沿敏感轴的标度因数"
    assert term("a & b at 20 degC") == "a & b 在 20 °C 时的值"
    assert term("Series 20degC/r1 has 3 of 12 rates: it is left out.") == (
        "测量序列 20degC/r1 仅有 12 个角速率中的 3 个，未予采用。"
    )
    for unknown in ("offset at zero rate of gyro_x", ": offset at zero rate", "gyro_x: offset at zero rates"):
        assert term(unknown) == unknown
    assert spoken("en")["term"]("gyro_x: offset at zero rate") == "gyro_x: offset at zero rate"


def test_a_name_that_stands_twice_is_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "de.po").write_text(
        'msgid "%(a)s by %(a)s (%(b)s %%)"\nmsgstr "%(a)s je %(a)s: %(b)s %%"\n', encoding="utf-8"
    )
    monkeypatch.setattr(catalogues, "shipped", lambda folder: tmp_path)
    for cached in (catalogues.translations, catalogues.sentences):
        cached.cache_clear()
    try:
        term = spoken("de")["term"]
        assert term("m by m (5 %)") == "m je m: 5 %"
        assert term("m by s (5 %)") == "m by s (5 %)"
    finally:
        for cached in (catalogues.translations, catalogues.sentences):
            cached.cache_clear()


def test_placeholders_are_names_and_nothing_more() -> None:
    assert filled("%(a)s of %(b)s, 5 %%, %d %(a)9999999d", {"a": 1, "b": "%(a)s"}) == "1 of %(a)s, 5 %, %d %(a)9999999d"
    with pytest.raises(KeyError):
        filled("%(missing)s", {})
    english = spoken("en")
    assert english["ngettext"]("%(num)s day", "%(num)s days", 1) == "1 day"
    assert english["ngettext"]("%(num)s day", "%(num)s days", 3) == "3 days"


HARMLESS = {
    "{{ term('%(x)s 5 %%') }}": "%(x)s 5 %%",
    "{{ _('%(x)999999999s', x=1) }}": "%(x)999999999s",
    "{% trans x=given %}<b>{{ x }}</b>{% endtrans %}": "&lt;b&gt;&lt;i&gt;&lt;/b&gt;",
    "{{ _(given) }}{{ term(given) }}": "&lt;i&gt;&lt;i&gt;",
    "{% trans n=2 %}one{% pluralize %}{{ n }} of them{% endtrans %}": "2 of them",
}


@pytest.mark.parametrize("template", HARMLESS)
def test_a_template_can_translate_and_nothing_more(template: str, tmp_path: Path) -> None:
    (tmp_path / "own.html.j2").write_text(template, encoding="utf-8")
    assert render("own.html", {"given": "<i>"}, tmp_path) == HARMLESS[template]


@pytest.mark.parametrize(
    "template",
    ["{{ gettext.__globals__ }}", "{{ _.__closure__ }}", "{{ _('%(x)s') }}", "{% trans %}{{ nowhere }}{% endtrans %}"],
)
def test_the_functions_open_no_door(template: str, tmp_path: Path) -> None:
    (tmp_path / "own.html.j2").write_text(template, encoding="utf-8")
    with pytest.raises(ReportError):
        render("own.html", {"given": "<i>"}, tmp_path)


def test_a_template_of_that_very_name_goes_before_a_translation(tmp_path: Path) -> None:
    (tmp_path / "certificate.zh.html.j2").write_text("own {{ language }}", encoding="utf-8")
    assert render("certificate.zh.html", {}, tmp_path) == "own en"
    (tmp_path / "mine.html.j2").write_text("{{ language }} {% trans %}Customer{% endtrans %}", encoding="utf-8")
    assert render("mine.zh.html", {}, tmp_path) == "zh 客户"
    with pytest.raises(ReportError, match="there is no template"):
        render("mine.xx.html", {}, tmp_path)
