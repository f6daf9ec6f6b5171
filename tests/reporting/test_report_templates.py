"""Templates lay out what they are given and can do nothing else; their mistakes are named with file and line."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from reporting_example import context

from planrunner.reporting import sandbox, templates
from planrunner.reporting.sandbox import ReportError, available, lay_out
from planrunner.reporting.templates import Told, from_json, render, to_json
from planrunner.reporting.view import Picture, report_view

ESCAPES = (
    "{{ ''.__class__.__mro__ }}",
    "{{ title.__class__ }}",
    "{{ (title|attr('__class__')).__mro__ }}",
    "{{ title['__class__'] }}",
    "{{ self.__init__.__globals__ }}",
    "{{ range.__globals__ }}",
    "{{ cycler.__init__.__globals__.os.popen('id').read() }}",
    "{{ lipsum.__globals__ }}",
    "{{ facts.update({'a': 1}) }}",
    "{{ facts.clear() }}",
    "{{ rows.append(1) }}",
    "{{ '%999999999d' % 1 }}",
    "{{ 'a' * 999999999 }}",
    "{{ 9**9**9 }}",
    "{{ title.ljust(999999999) }}",
    "{{ '{0.__class__}'.format(title) }}",
    "{{ title.format_map(facts) }}",
    "{{ '{:999999999}'.format(1) }}",
    "{{ 'a'.__mul__(999999999) }}",
    "{{ title|center(999999999) }}",
    "{% import 'os' as os %}",
    "{% include '/etc/passwd' %}",
    "{% include '../secret.html.j2' %}",
    "{% extends '../../pyproject.toml' %}",
    "{{ undefined_name }}",
    "{{ facts.nothing }}",
    "{% for i in range(10**9) %}x{% endfor %}",
)
GIVEN = {"title": "T <b>", "facts": {"k": "v"}, "rows": [1, 2]}


def write(folder: Path, text: str, name: str = "own.html.j2") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.mark.parametrize("attempt", ESCAPES)
def test_a_template_cannot_reach_out(attempt: str, tmp_path: Path) -> None:
    (tmp_path / "secret.html.j2").write_text("secret", encoding="utf-8")
    folder = write(tmp_path / "t", "first line\n" + attempt)
    with pytest.raises(ReportError) as caught:
        lay_out("own.html", GIVEN, folder)
    message = str(caught.value)
    assert "own.html.j2:2: " in message or "there is no template" in message
    assert "Traceback" not in message


def test_what_a_template_may_do(tmp_path: Path) -> None:
    text = (
        "{% for k, v in facts.items() %}{{ k.upper() }}={{ v }}{% endfor %} {{ 3 * 4 }} {{ rows|length }} {{ title }}"
    )
    assert lay_out("own.html", GIVEN, write(tmp_path, text)) == "K=v 12 2 T &lt;b&gt;"


def test_a_link_does_not_lead_out_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("secret", encoding="utf-8")
    folder = write(tmp_path / "t", "x")
    try:
        (folder / "link.html.j2").symlink_to(tmp_path / "secret.txt")
    except OSError:
        pytest.skip("no symbolic links here")
    with pytest.raises(ReportError, match=r"link\.html\.j2: a link that leads out of the folder"):
        lay_out("link.html", GIVEN, folder)


def test_mistakes_are_named_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match=r"own\.html\.j2:3: .*endfor"):
        lay_out("own.html", GIVEN, write(tmp_path, "a\nb\n{% for x in rows %}{{ x }}"))
    with pytest.raises(ReportError, match=r"own\.html\.j2:2: ZeroDivisionError"):
        lay_out("own.html", GIVEN, write(tmp_path / "z", "a\n{{ 1 / 0 }}"))
    folder = write(tmp_path / "b", "")
    (folder / "own.html.j2").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ReportError, match=r"own\.html\.j2: the template is not UTF-8"):
        lay_out("own.html", GIVEN, folder)


def test_own_templates_come_first_and_may_use_the_shipped_parts(tmp_path: Path) -> None:
    text = "{% import 'partials/blocks.html.j2' as blocks %}{{ blocks.facts([['a', '<i>']]) }}"
    page = lay_out("report.html", {}, write(tmp_path, text, "report.html.j2"))
    assert "<dt>a</dt><dd>&lt;i&gt;</dd>" in page
    assert "report.html" in available()
    assert "own.html" in available(write(tmp_path, "x"))


def test_a_report_does_not_grow_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(templates, "MAX_OUTPUT", 5000)
    with pytest.raises(ReportError, match="grows beyond"):
        render("own.html", GIVEN, write(tmp_path, "{% for i in range(90000) %}0123456789{% endfor %}"))


def test_a_template_without_its_ending_is_told_so(tmp_path: Path) -> None:
    folder = write(tmp_path, "x")
    (folder / "plain.html").write_text("x", encoding="utf-8")
    with pytest.raises(ReportError, match=r"'plain\.html' is not named as a template: rename it to 'plain\.html\.j2'"):
        lay_out("plain.html", GIVEN, folder)


def test_unknown_template_and_folder(tmp_path: Path) -> None:
    with pytest.raises(
        ReportError, match=r"no template 'certificat\.html\.j2'; the known templates are .*report\.html"
    ):
        lay_out("certificat.html", {})
    with pytest.raises(ReportError, match="is not a folder"):
        lay_out("report.html", {}, tmp_path / "missing")


def refused(text: str, folder: Path) -> str:
    """What is said of a template that is laid out in the child process."""
    with pytest.raises(ReportError) as caught:
        render("own.html", GIVEN, write(folder, text))
    message = str(caught.value)
    assert "Traceback" not in message
    return message


LOOP = "{% for a in range(90000) %}{% for b in range(90000) %}{% if a < 0 %}x{% endif %}{% endfor %}{% endfor %}"
HOARD = "{% set all = namespace(x=[rows]) %}{% for i in range(60) %}{% set all.x = [all.x|list|string, all.x|string] %}{% endfor %}"


def test_a_template_that_never_ends_is_ended_and_named_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(templates, "MAX_SECONDS", 0.5)
    monkeypatch.setattr(templates, "PATIENCE", 1000)  # a busy computer
    message = refused(f"a\n\n{LOOP}", tmp_path)
    assert message.startswith("own.html.j2:3: ")
    assert "0.5 s" in message


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux holds a process to a limit of its memory")
def test_a_template_that_fills_the_memory_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(templates, "MAX_MEMORY", 300_000_000)
    message = refused(f"a\n{HOARD}", tmp_path)
    assert "own.html" in message
    assert "memory" in message


def test_a_child_that_does_not_answer_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(templates, "PATIENCE", 1e-6)
    assert "takes longer" in refused("x", tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="pipes as files are of POSIX systems")
def test_a_template_that_is_a_pipe_or_too_large_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "own.html.j2")
    with pytest.raises(ReportError, match="a pipe"):
        lay_out("own.html", GIVEN, tmp_path)
    (tmp_path / "own.html.j2").unlink()
    with pytest.raises(ReportError, match="larger than 1 MB"):
        lay_out("own.html", GIVEN, write(tmp_path, "x" * (sandbox.MAX_TEMPLATE + 1)))


def test_a_page_from_the_child_is_the_page_from_this_process(tmp_path: Path) -> None:
    given = report_view(context(estimates=()))
    folder = write(tmp_path, "{% extends 'report.html.j2' %}")
    assert render("own.html", given, folder) == render("report.html", given)


def test_data_pass_to_the_child_unchanged() -> None:
    given = {
        "text": "<é\u2028\ud800>",
        "html": {"html": "<b>"},
        "pairs": {"pairs": [1, 2.5, None, True, float("inf")]},
        "told": Told(a="b"),
        "numbers": {1: "one"},
        "picture": Picture(lambda: "<svg/>"),
    }
    found = from_json(to_json(given))
    assert found["told"]["absent"] == ""
    assert found["picture"].__html__() == "<svg/>"
    assert not hasattr(found["html"], "__html__")
    assert {name: found[name] for name in found if name != "picture"} == {
        name: given[name] for name in given if name != "picture"
    }
    with pytest.raises(TypeError):
        to_json({"thing": object()})
