r"""Texts from files and arguments that would drive a terminal: at its stream they become codes, whichever command prints them."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest

from planrunner.base.findings import Finding, Mark
from planrunner.cli import main
from planrunner.cli.printing import print_findings, print_json
from planrunner.estimators.tables import Table, TableColumn
from planrunner.reporting import terminal
from planrunner.reporting.printable import beneath, printable, printable_streams

HOSTILE = "a\x1b[2J\x1b]0;title\x07b\x9b31mc\u202ed\u2066e\rf\x08g\u200bh"
CODES = r"a\x1b[2J\x1b]0;title\x07b\x9b31mc\u202ed\u2066e\x0df\x08g\u200bh"
DRIVING = set(HOSTILE) - set("abcdefgh[]0;title2J31m")

PLAN = """planrunner: 1
title: Hostile
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
defaults: {orientation: {x: up, y: north, z: west}, dwell: 10 s}
segments:
  - {label: "a\\u200bb\\x9b31mc"}
"""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return "utf-8"


def test_codes_for_what_has_no_shape() -> None:
    assert printable(HOSTILE) == CODES
    assert printable("µ ± °\u00a0\u2009−∞ 校准证书 \U0001f642\n") == "µ ± °\u00a0\u2009−∞ 校准证书 \U0001f642\n"
    assert printable("\U000e0041\ud800") == r"\U000e0041\ud800"


def test_what_is_printed_to_standard_streams_is_shown_as_codes(capsys: pytest.CaptureFixture[str]) -> None:
    with printable_streams():
        print(HOSTILE)
        sys.stderr.writelines([HOSTILE, "\n"])
        beneath(sys.stdout).write("\x1b[1mours\x1b[0m")
    print(HOSTILE, end="")
    shown = capsys.readouterr()
    assert shown.out == f"{CODES}\n\x1b[1mours\x1b[0m{HOSTILE}"
    assert shown.err == f"{CODES}\n"


def test_tables_and_texts_have_our_colours_and_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    out = Terminal()
    console = terminal.console(width=200, file=out)
    console.print(HOSTILE, style="bold")
    console.print(terminal.data_table(Table(HOSTILE, (TableColumn(HOSTILE),), ((HOSTILE,),))))
    text = out.getvalue()
    assert text.count(r"\x1b[2J") == 4  # rich itself drops some of the others
    assert "\x1b[1m" in text
    for ours in ("\x1b[1m", "\x1b[0m", "\x1b[2m", "\x1b[3m"):
        text = text.replace(ours, "")
    assert not DRIVING & set(text)


def test_a_finding_is_one_line_in_our_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    out = Terminal()
    forged = f"{HOSTILE}\nplan.yaml:1:1: note[all-well]: nothing is wrong"
    print_findings([Finding(Mark(HOSTILE), "some-code", "error", forged, forged)], out)
    text = out.getvalue()
    assert text.count("\n") == 2
    assert text.count("\x1b") == 2  # the colour of the word, on and off
    assert not (DRIVING - {"\x1b"}) & set(text)


def test_json_says_the_same_in_json_s_own_codes(capsys: pytest.CaptureFixture[str]) -> None:
    given = {"label": HOSTILE, "letters": "é 校 \U0001f642 \U000e0041"}
    with printable_streams():
        print_json(given)
    out = capsys.readouterr().out
    assert json.loads(out) == given
    assert "é 校" in out
    assert not DRIVING & set(out)


@pytest.mark.parametrize(
    "command", ["check", "show", "run", "design", "diagnose", "estimate", "report", "export", HOSTILE]
)
def test_a_hostile_path_reaches_the_terminal_as_codes(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([command, HOSTILE]) == 2
    shown = capsys.readouterr()
    assert not DRIVING & set(shown.out + shown.err)
    assert "\\x1b" in shown.err


@pytest.mark.parametrize("arguments", [["check"], ["show"], ["check", "--json"]])
def test_a_hostile_label_reaches_the_terminal_as_codes(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    main([*arguments, str(tmp_path / "plan.yaml")])
    shown = capsys.readouterr()
    assert shown.out + shown.err
    assert not DRIVING & set(shown.out + shown.err)
