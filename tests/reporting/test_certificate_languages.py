"""Certificates in English and Chinese from one template: catalogues are complete and up to date, and a template stays harmless."""

from __future__ import annotations

import ast
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import entry_points
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

from planrunner.base.said import counted, said
from planrunner.error_model.flexure_gyro import output_names, physical_names
from planrunner.estimators.flexure_gyro.flexure_gyro_static import descriptions
from planrunner.reporting import language as catalogues
from planrunner.reporting.certificate_names import of_estimator, of_reference, of_room
from planrunner.reporting.language import filled, languages, spoken, translations
from planrunner.reporting.sandbox import ReportError, available
from planrunner.reporting.templates import render
from planrunner.reporting.view import render_report

ROOT = Path(__file__).resolve().parents[2]
LOCALES = ROOT / "locales"
PLACE = re.compile(r"%\((\w+)\)s|\{(\w+)(?::[^}]*)?\}|%%")


def catalogue(name: str) -> Catalog:
    language = name.removesuffix(".po") if name.endswith(".po") else None
    return read_po(io.BytesIO((LOCALES / name).read_bytes()), locale=language)


def messages(found: Catalog) -> dict[str, Any]:
    """Messages by the English text, or by the singular."""
    return {message.id if isinstance(message.id, str) else message.id[0]: message for message in found if message.id}


def of_templates() -> set[str]:
    """The messages of the page templates."""
    with (ROOT / "babel.cfg").open(encoding="utf-8") as file:
        methods, options = parse_mapping_cfg(file)
    pages = [(pattern, method) for pattern, method in methods if method != "python"]
    found = (message[2] for message in extract_from_dir(ROOT, pages, options, directory_filter=not_code))
    return {message if isinstance(message, str) else message[0] for message in found}


def not_code(folder: str | Path) -> bool:
    return Path(folder) == ROOT or Path(folder).name == "templates"


def said_in_code() -> Iterator[str]:
    """The templates of the texts that the code makes, in nested calls too; the singular if there is a plural."""
    for path in sorted((ROOT / "planrunner").rglob("*.py")):
        code = path.read_text(encoding="utf-8")
        if "base.said import" in code:
            calls = (node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call))
            for call in calls:
                if isinstance(call.func, ast.Name) and call.func.id in ("said", "counted"):
                    template = call.args[0]
                    assert isinstance(template, ast.Constant), f"{path}:{call.lineno}: the template must be a literal"
                    yield str(template.value)


def test_the_catalogues_hold_what_templates_and_code_say() -> None:
    found = of_templates() | set(said_in_code())
    assert len(found) > 300
    for name in ("planrunner.pot", *(f"{language}.po" for language in languages())):
        assert set(messages(catalogue(name))) == found, f"{name}: run `make catalogues` and translate"


@pytest.mark.parametrize("language", languages())
def test_every_message_is_translated_with_its_placeholders(language: str) -> None:
    for text, message in messages(catalogue(f"{language}.po")).items():
        assert not message.fuzzy, text
        for words in (message.string,) if isinstance(message.string, str) else message.string:
            assert words, text
            assert sorted(PLACE.findall(words)) == sorted(PLACE.findall(text)), text
            assert words != text, text


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
        conditions=tuple((of_room(name), "10") for name in ("temperature", "pressure", "humidity")),
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


def test_only_names_of_the_program_are_translated() -> None:
    """Names that a laboratory gives stay as they are, even if a word of them is in the catalogue."""
    term = spoken("zh")["term"]
    assert (term(of_reference("table", "table")), term(of_reference("table", "chamber"))) == ("转台", "table")
    assert term(of_reference("table 2", "table")) == "table 2"
    assert term(of_room("air_flow")) == "环境条件：air flow"
    assert term(of_estimator("someone's own")) == "someone's own"
    assert term("Ambient temperature") == "Ambient temperature"  # as a laboratory may call one of its instruments


def test_both_languages_hold_the_same_figures_and_dates() -> None:
    english, chinese = (
        re.sub(r"<style>.*?</style>", "", render_report(example.context(), name), flags=re.DOTALL)
        for name in ("certificate.html", "certificate.zh.html")
    )
    figures = [re.findall(r"-?\d[\d.\-/]*", " ".join(read(page).words)) for page in (english, chinese)]
    assert sorted(figures[0]) == sorted(figures[1])
    assert "2026-03-05" in figures[1]


# Abbreviations, names of standards, keys of plans and units that Chinese texts keep; estimators keep the name that plans use.
KEPT = {
    "IEEE",
    "Std",
    "ln",
    "pool_outputs",
    "false",
    "rings",
    "highest_order",
    "groups",
    "outliers",
    "exclude",
    "draws",
    "order",
    "repeat",
    "drift",
    "gimbal_axes",
    "temperature",
    "none",
}
KEPT |= {
    "bias_instability",
    "gyro_uncertainty",
    "accelerometer_uncertainty",
    "rate_uncertainty",
    "radial_error_rate",
    "deg",
    "mg",
    "mm",
    "nmi",
    "cos",
    "tan",
}


def test_translated_words_have_no_english_left() -> None:
    chinese = translations("zh")
    sentences = [text for text in chinese if "{" in text]
    assert len(sentences) > 100
    estimators = {entry.name for entry in entry_points(group="planrunner.estimators") if "planrunner." in entry.value}
    for text in (*sentences, *estimators):
        own = {text} & estimators
        left = set(re.findall(r"[A-Za-z]{2,}(?:_[a-z]+)*", PLACE.sub("", str(chinese[text])))) - KEPT - own
        assert not left, text


def test_texts_with_names_and_numbers_are_translated() -> None:
    term = spoken("zh")["term"]
    offset = said("{output}: offset at zero rate", output="gyro_x")
    assert term(offset) == "gyro_x：零速率时的偏置"
    factor = said("scale factor along the axis")
    cold = said("{celsius:g}degC", celsius=-40.0)
    assert (
        term(said("{axis} at {temperature}: {quantity}", axis="x", quantity=factor, temperature=cold))
        == "x：-40 °C 时沿敏感轴的标度因数"
    )
    fewer = said("has {count} of {most} rates", count=3, most=12)
    left_out = said("Series {series} {why}, so it is left out.", series="20degC/r1", why=fewer)
    assert left_out == "Series 20degC/r1 has 3 of 12 rates, so it is left out."
    assert term(left_out) == "测量序列 20degC/r1 仅有 12 个角速率中的 3 个，未予采用。"
    # A name is not a text, even if a catalogue has the same word; nor is a plain text, as of results of an earlier version.
    assert term(said("{output}: offset at zero rate", output="site")) == "site：零速率时的偏置"
    assert term("gyro_x: offset at zero rate") == "gyro_x: offset at zero rate"
    assert spoken("en")["term"](offset) == "gyro_x: offset at zero rate"


GERMAN = """
msgid "{ratio:.3g} times ({names})"
msgstr "({names}) {ratio}-fach"

msgid "{count} sample"
msgid_plural "{count} samples"
msgstr[0] "{count} Messwert"
msgstr[1] "{count} Messwerte"
"""


def test_numbers_and_plurals_are_those_of_the_language(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "de.po").write_text(GERMAN, encoding="utf-8")
    monkeypatch.setattr(catalogues, "shipped", lambda folder: tmp_path)
    catalogues.translations.cache_clear()
    try:
        term = spoken("de")["term"]
        assert term(said("{ratio:.3g} times ({names})", ratio=1.23456, names=("a.b", "c"))) == "(a.b, c) 1,23-fach"
        assert [term(counted("{count} sample", "{count} samples", n)) for n in (1, 2)] == ["1 Messwert", "2 Messwerte"]
        assert term(said("{ratio:.3g} new {count}", ratio=0.5, count=2)) == "0,5 new 2"
    finally:
        catalogues.translations.cache_clear()


def test_texts_with_a_singular_are_translated() -> None:
    many = (
        "Uncertainties are based on the residuals: {freedom} degrees of freedom for each output. The fewer degrees of freedom, the "
        "larger the coverage factors."
    )
    one = many.replace("degrees", "degree", 1)
    term = spoken("zh")["term"]
    now = counted(one, many, 1, freedom=1)
    assert ": 1 degree of freedom for" in now and ": 2 degrees of freedom for" in counted(one, many, 2, freedom=2)
    assert term(now) == "不确定度基于残差：每个输出的自由度为 1。自由度越少，包含因子越大。"


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
