"""The excerpt under a finding: the line that was read, with carets that stand under the place."""

from __future__ import annotations

import io
import json
import re
import unicodedata
from pathlib import Path

import pytest

from planrunner.base.findings import Finding, InputError, Mark
from planrunner.cli import main
from planrunner.cli.printing import Excerpt, excerpt, print_findings
from planrunner.plan import source
from planrunner.tasks.check import check_plan

PLAN = """\
planrunner: 1
title: Two mistakes
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
defaults: {orientation: {x: up, y: northh}, dwell: 30}
segments:
  - {label: zero}
"""


def marked(text: str, place: str, file: str = "plan.yaml") -> Mark:
    """The mark of a piece of the first line of `text`."""
    at = text.index(place)
    return Mark(file, 1, at + 1, (1, at + 1 + len(place)), text)


def shown(text: str, place: str, width: int = 80, encoding: str = "utf-8") -> Excerpt:
    found = excerpt(marked(text, place), width, encoding)
    assert found is not None
    return found


def columns(text: str) -> int:
    """Columns of a terminal, by the Unicode tables of Python itself."""
    return sum(
        0 if unicodedata.combining(char) else 2 if unicodedata.east_asian_width(char) in "WF" else 1 for char in text
    )


def under(found: Excerpt) -> str:
    """What stands above the carets, found by columns."""
    begin, count = found.carets.index("^"), found.carets.count("^")
    text, at = "", 0
    for char in found.line:
        if begin <= at < begin + count or (text and not columns(char)):
            text += char
        at += columns(char)
    return text


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("dwell: 30", "30"),
        ("label: 零点校准, dwell: 30", "30"),
        ("label: 零点校准, dwell: 30", "校准"),
        ("label: re\u0301sume\u0301, dwell: 30", "30"),
        ("label: °±µ, dwell: 30", "30"),
        ("label: ｆｕｌｌ, dwell: 30", "30"),
    ],
)
def test_carets_stand_under_the_place(text: str, place: str) -> None:
    assert under(shown(text, place)) == place


def test_the_gutter_carries_the_line_number_and_both_lines_begin_at_one_column() -> None:
    mark = Mark("plan.yaml", 120, 3, (120, 5), "\n" * 119 + "a:bc\n")
    found = excerpt(mark, 80)
    assert found is not None
    assert found.gutter.split() == ["120", "|"]
    assert len(found.gutter) == len(found.blank)
    assert (found.line, found.carets) == ("a:bc", "  ^^")


def test_tabs_keep_the_carets_in_place_however_wide_the_terminal_draws_them() -> None:
    found = shown("drift:\t{estimator:\tx}", "x}")
    assert "\t" not in found.line
    assert under(found) == "x}"


@pytest.mark.parametrize("width", [24, 40, 79])
@pytest.mark.parametrize("before", [0, 3, 10, 60, 400])
@pytest.mark.parametrize("after", [0, 3, 60, 400])
def test_a_long_line_is_cut_around_the_place(width: int, before: int, after: int) -> None:
    found = shown("长" * before + " here " + "b" * after, "here", width)
    assert columns(found.gutter + found.line) <= width
    assert columns(found.gutter + found.carets) <= width
    assert under(found) == "here"
    whole = 2 * before + 6 + after <= width - len(found.gutter)
    assert ("..." in found.line) != whole


def test_what_could_drive_a_terminal_is_shown_as_a_code_and_counted_as_such() -> None:
    found = shown("a\x1b[31m\x9b\u202e: 30", "30")
    assert found.line.isprintable()
    assert under(found) == "30"


def test_what_the_encoding_lacks_is_counted_as_it_is_written() -> None:
    found = shown("label: 零°, dwell: 30", "30", encoding="ascii")
    assert found.line.isascii()
    assert under(found) == "30"


def test_a_place_after_the_end_of_a_line_and_of_the_text() -> None:
    after = excerpt(Mark("f", 1, 5, None, "key:"), 80)
    assert after is not None and after.carets == "    ^"
    assert excerpt(Mark("f", 9, 1, None, "key:"), 80) is None
    assert excerpt(Mark("f"), 80) is None


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_are_counted_as_yaml_counts_them(end: str) -> None:
    with pytest.raises(InputError) as caught:
        source.parse(end.join(["a: 1", "# note", "b: {c: 1, c: 2}"]), "f")
    found = excerpt(caught.value.findings[0].mark, 80)
    assert found is not None
    assert found.line == "b: {c: 1, c: 2}"
    assert under(found) == "c"
    assert found.carets.index("^") == 10


def printed(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    main(arguments)
    both = capsys.readouterr()
    return both.err + both.out


@pytest.mark.parametrize("command", ["check", "show", "run", "design", "simulate"])
def test_every_command_shows_the_line_of_each_finding_once(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    line = PLAN.splitlines()[3]
    output = printed([command, str(path)], capsys)
    assert output.count(line) == 2, "two findings on one line, each with its own carets"
    carets = [row.rsplit("| ", 1)[1] for row in output.splitlines() if row.endswith("^")]
    assert [line[row.index("^") : len(row)] for row in carets] == ["northh", "30"]
    plain = printed([command, str(path), "--no-excerpt"], capsys)
    assert line not in plain and "^" not in plain
    assert "form-direction" in plain and "form-unit-missing" in plain
    assert line in printed([command, str(path)], capsys), "the option holds for one command"


def test_json_has_no_excerpt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    main(["check", "--json", str(path)])
    output = capsys.readouterr()
    assert not output.err
    for row in json.loads(output.out):
        assert set(row) == {"file", "line", "column", "code", "severity", "message", "hint"}


def test_the_line_is_shown_when_the_file_is_gone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    checked = check_plan(path)
    path.unlink()
    print_findings(checked.findings)
    assert PLAN.splitlines()[3] in capsys.readouterr().err


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_carets_are_coloured_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    finding = Finding(marked("dwell: 30", "30"), "form-unit-missing", "error", "no unit")
    terminal, pipe = Terminal(), io.StringIO()
    print_findings([finding], terminal)
    print_findings([finding], pipe)
    assert "\x1b[31;1m       ^^\x1b[0m" in terminal.getvalue()
    assert "\x1b" not in pipe.getvalue()
    monkeypatch.setenv("NO_COLOR", "1")
    plain = Terminal()
    print_findings([finding], plain)
    assert "\x1b" not in plain.getvalue()


def test_diagnose_shows_what_is_wrong_with_its_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    assert main(["diagnose", str(path), "--recording", "none.csv"]) == 2
    shown = capsys.readouterr().err
    assert "northh}, dwell" in shown and "^^^^^^" in shown


@pytest.mark.parametrize(
    "words",
    [
        ["report", "{folder}", "no-such-report"],
        ["export", "{folder}", "{folder}"],
        ["run", "{plan}", "--json", "--no-such-option"],
    ],
)
def test_what_is_wrong_with_the_command_line_has_no_line_and_no_excerpt(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
    assert main([word.format(folder=tmp_path, plan=plan) for word in words]) == 2
    said = capsys.readouterr()
    assert "command line: error[" in said.err and not re.search(r"^ *\d* \|", said.err, re.MULTILINE)
    if "--json" in words:
        (finding,) = json.loads(said.out)
        assert (finding["file"], finding["line"], finding["column"]) == ("<command line>", 1, 1)
