"""YAML 1.2 meaning, exact positions, and refusal of everything that is no plan text."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import pytest

from planrunner.base.findings import Findings, InputError, Mark
from planrunner.plan import source


def value_of(text: str) -> object:
    node = source.parse(f"key: {text}", "f.yaml").get("key")
    assert node is not None
    return source.plain(node)


def error_of(text: str) -> tuple[str, int, int]:
    with pytest.raises(InputError) as caught:
        source.parse(text, "f.yaml")
    finding = caught.value.findings[0]
    assert finding.mark.file == "f.yaml"
    assert finding.message
    return finding.code, finding.mark.line, finding.mark.column


@pytest.mark.parametrize(
    ("text", "value"),
    [
        # The core schema of YAML 1.2.2, 10.3.2; the comments say what YAML 1.1 would have made of them.
        ("1e-3", 0.001),  # a string
        ("1E+2", 100.0),
        ("1.", 1.0),
        (".5", 0.5),
        ("-.5e1", -5.0),
        ("685_230", "685_230"),  # 685230
        ("0777", 777),  # 511
        ("0o17", 15),  # a string
        ("0x1F", 31),
        ("0b101", "0b101"),  # 5
        ("12:30", "12:30"),  # 750
        ("12:30:45.5", "12:30:45.5"),
        ("2020-01-01", "2020-01-01"),  # a date
        ("no", "no"),  # false
        ("Yes", "Yes"),  # true
        ("on", "on"),
        ("off", "off"),
        ("y", "y"),
        ("true", True),
        ("FALSE", False),
        ("tRue", "tRue"),
        ("~", None),
        ("null", None),
        ("", None),
        ("nULL", "nULL"),
        ("=", "="),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("inf", "inf"),
        ("nan", "nan"),
        ("1,000", "1,000"),
        ("'1'", "1"),
        ('"1e-3"', "1e-3"),
        ("'no'", "no"),
        ('""', ""),
        ("! 12", "12"),
        ('"\\u00b1 5"', "± 5"),
        ("99999999999999999999", 1e20),
        ("1e999", math.inf),
    ],
)
def test_values_have_the_meaning_of_yaml_1_2(text: str, value: object) -> None:
    found = value_of(text)
    assert found == value
    assert type(found) is type(value)


def test_not_a_number_is_a_number_in_yaml() -> None:
    found = value_of(".nan")
    assert isinstance(found, float)
    assert math.isnan(found)


def test_blocks_are_strings() -> None:
    assert value_of("|\n  1\n  2\n") == "1\n2\n"
    assert value_of(">\n  1\n  2\n") == "1 2\n"


def test_anchors_stand_for_what_they_name() -> None:
    root = source.parse("a: &x {b: [1, 2]}\nc: *x\nd: [*x, *x]\n", "f")
    assert source.plain(root) == {"a": {"b": [1, 2]}, "c": {"b": [1, 2]}, "d": [{"b": [1, 2]}, {"b": [1, 2]}]}


def test_marks_count_characters_and_lines_as_editors_do() -> None:
    text = "title: Größe ±\n\n# a comment\nsegments:\n  - {label: ä, dwell: 5 s}\n  -\n    label: [b]\n"
    root = source.parse(text, "f")
    segments = root.get("segments")
    assert isinstance(segments, source.Sequence)
    first, second = segments.items
    assert isinstance(first, source.Mapping)
    assert isinstance(second, source.Mapping)
    lines = text.split("\n")
    assert first.mark == Mark("f", 5, lines[4].index("{") + 1)
    dwell, label = first.get("dwell"), second.get("label")
    assert dwell is not None
    assert label is not None
    assert dwell.mark == Mark("f", 5, lines[4].index("5 s") + 1)
    assert label.mark == Mark("f", 7, lines[6].index("[") + 1)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_of_all_systems(end: str) -> None:
    root = source.parse(f"a: 1{end}{end}b:{end}  c: x{end}", "f")
    inner = root.get("b")
    assert isinstance(inner, source.Mapping)
    c = inner.get("c")
    assert c is not None
    assert c.mark == Mark("f", 4, 6)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbfplanrunner: 1\r\n")
    root = source.load(path)
    assert source.plain(root) == {"planrunner": 1}
    assert root.mark == Mark(str(path), 1, 1)


@pytest.mark.parametrize(
    ("text", "code", "line", "column"),
    [
        ("a: 1\na: 2\n", "syntax-duplicate-key", 2, 1),
        ("a: {b: 1, c: 2, b: 3}\n", "syntax-duplicate-key", 1, 17),
        ('a: 1\n"a": 2\n', "syntax-duplicate-key", 2, 1),
        ("a:\n\tb: 1\n", "syntax-tab", 2, 1),
        ("a:\n  - b\n \t- c\n", "syntax-tab", 3, 2),
        ("a: [1, 2\n", "syntax", 2, 1),
        ("a: 'open\n\nb: 1\n", "syntax", 1, 4),
        ("a: b: c\n", "syntax", 1, 5),
        ("a: @home\n", "syntax", 1, 4),
        ("a: *nowhere\n", "syntax-alias", 1, 4),
        ("a: &a [*a]\n", "syntax-alias", 1, 8),
        ("a: !!python/object/apply:os.system ['x']\n", "syntax-tag", 1, 4),
        ("a: !custom 5\n", "syntax-tag", 1, 4),
        ("a: 1\n---\nb: 2\n", "form-documents", 2, 1),
        ("a: x\x07y\n", "syntax-character", 1, 5),
        ("a: 1\nb: x\u2028y\n", "syntax-character", 2, 5),
        ("é: 1\nb: \x00\n", "syntax-character", 2, 4),
        ("a: \ud800\n", "syntax-character", 1, 4),
        ("a: 1 # x\u202ey\n", "syntax-character", 1, 9),
        ("a: SN-\u2066 7\n", "syntax-character", 1, 7),
        ('a: "SN-\\u202e7"\n', "syntax-character", 1, 4),
        ('a: "SN-\\u200b7"\n', "syntax-character", 1, 4),
        ('a: 1\n"SN\\x9b": 1\n', "syntax-character", 2, 1),
        ('a: "x\\x1b[31m"\n', "syntax-character", 1, 4),
        ('a: "x\\u2029y"\n', "syntax-character", 1, 4),
        ('a: "\\0"\n', "syntax-character", 1, 4),
        ("base: &b {x: 1}\nc:\n  <<: *b\n", "syntax-merge", 3, 3),
        ("? [1, 2]\n: 3\n", "form-key", 1, 3),
        ("", "file-empty", 1, 1),
        ("# nothing\n\n", "file-empty", 1, 1),
        ("---\n...\n", "file-empty", 1, 1),
        ("- 1\n- 2\n", "form-type", 1, 1),
        ("just words", "form-type", 1, 1),
        ('a: "' + "x" * 20_000 + '"\n', "limit-text", 1, 4),
        ("a: [" + "1," * 30_000 + "]\n", "limit-nodes", 1, None),
    ],
)
def test_what_is_refused_and_where(text: str, code: str, line: int, column: int | None) -> None:
    found = error_of(text)
    assert found[:2] == (code, line)
    assert column is None or found[2] == column


def test_all_duplicate_keys_are_found_and_the_rest_is_still_read() -> None:
    log = Findings()
    root = source.parse("a: 1\na: 2\nb: {c: 1, c: 2}\n", "f", log)
    assert [(item.code, item.mark.line, item.mark.column) for item in log] == [
        ("syntax-duplicate-key", 2, 1),
        ("syntax-duplicate-key", 3, 11),
    ]
    assert source.plain(root) == {"a": 1, "b": {"c": 1}}


def bomb(levels: int = 12) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}"] * 9) + "]" for n in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[" * 10_000, "limit-depth"),
        ("{a: " * 10_000, "limit-depth"),
        ("- " * 10_000, "limit-depth"),
        ("? " * 10_000, "limit-depth"),
        ("\n".join(" " * n + "a:" for n in range(1_300)), "limit-depth"),
        ("\n".join(" " * n + "-" for n in range(1_300)), "limit-depth"),
        (bomb(), "limit-aliases"),
        ("a: [" + "&a " * 9_000 + "]", "syntax"),
        ("\n" * 900_000, "file-empty"),
        ("a: " + "x " * 400_000, "limit-text"),
        ("k: [" + "&x [1], " * 20_000 + "]", "limit-nodes"),
        ("".join(f"k{n}: &k{n} [" for n in range(15)), "syntax"),
    ],
    ids=[
        "flow",
        "flow-map",
        "dashes",
        "keys",
        "block-map",
        "block-list",
        "bomb",
        "anchors",
        "blank",
        "words",
        "anchored",
        "open",
    ],
)
def test_hostile_texts_are_refused_at_once(text: str, code: str) -> None:
    """In 0.15 s at most on a quiet computer; the bound is for what would go on for minutes, not for a busy one."""
    start = time.process_time()
    assert error_of(text)[0] == code
    assert time.process_time() - start < 5.0


def test_files_that_are_no_plans(tmp_path: Path) -> None:
    def code(path: Path) -> str:
        with pytest.raises(InputError) as caught:
            source.load(path)
        return caught.value.findings[0].code

    binary, large, encoded = tmp_path / "binary", tmp_path / "large", tmp_path / "utf16"
    binary.write_bytes(bytes(range(256)) * 10)
    large.write_bytes(b"# " + b"x" * 10_000_000)
    encoded.write_text("planrunner: 1\n", encoding="utf-16")
    assert code(binary) == "file-encoding"
    assert code(large) == "file-size"
    assert code(encoded) == "file-encoding"
    assert code(tmp_path) == "file-directory"
    assert code(tmp_path / "absent.yaml") == "file-missing"
    assert code(tmp_path / "binary" / "below-a-file.yaml") == "file-unreadable"
    assert code(Path("nul\0byte")) == "file-unreadable"


def test_an_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "locked.yaml"
    path.write_text("planrunner: 1\n")
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(InputError) as caught:
        source.load(path)
    (finding,) = caught.value.findings
    assert finding.code == "file-unreadable"
    assert "Permission denied" in finding.message


def test_the_place_of_a_byte_that_is_not_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "latin1.yaml"
    path.write_bytes("ä: 1\nb: Prüfung\n".encode().replace("ü".encode(), b"\xfc"))
    with pytest.raises(InputError) as caught:
        source.load(path)
    (finding,) = caught.value.findings
    assert (finding.code, finding.mark.line, finding.mark.column) == ("file-encoding", 2, 6)
