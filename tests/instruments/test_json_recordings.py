"""Recordings in JSON: the places that messages name, files that end too early, and values that are too large."""

from __future__ import annotations

import io
import json
import tracemalloc
from pathlib import Path

import pytest

from planrunner.base.findings import Findings
from planrunner.instruments.formats import json_samples, json_scan
from planrunner.instruments.formats.choice import open_file
from planrunner.instruments.formats.file import AnyFile, TimeStamps
from planrunner.instruments.formats.json_scan import JsonScanner
from planrunner.instruments.interfaces import InstrumentError


def opened(folder: Path, text: str, *channels: str, name: str = "r.jsonl", time: str | None = "t") -> AnyFile:
    (folder / name).write_text(text, encoding="utf-8")
    return open_file(
        folder / name, name, TimeStamps(time, period=1.0), dict(zip(channels, channels, strict=True)), None
    )


def read(file: AnyFile) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for _, values in file.rows():
        for name, part in values.items():
            found.setdefault(name, []).extend(part.tolist())
    return found


GOOD = '{"t": 1, "x": 0.5}\n{"t": 2, "x": null}\n{"t": 3}\n{"t": 4, "x": "1.5"}\n{"t": 5, "x": true}\n'


def test_missing_numbers_and_numbers_in_quotes(tmp_path: Path) -> None:
    """A number that is null is missing. A sample without the channel comes from another instrument."""
    file = opened(tmp_path, GOOD, "x")
    assert read(file)["x"] == pytest.approx([0.5, float("nan"), 1.5, 1.0], nan_ok=True)
    assert file.remarks == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"t": 1, "x": 1}\n{"t": 2, "x": 1e}\n{"t": 3, "x": 1}', "line 2, column 16: expecting ',' delimiter"),
        ('{"t": 1, "x": 1}\n\n{"t": 2, x: 1}\n', "line 3, column 10: expecting property name"),
        ('[{"t": 1, "x": 1}\n {"t": 2, "x": 1}]', "line 2, column 2: a comma or ] is missing between two elements"),
        ('[{"t": 1, "x": 1},\n]', "line 2, column 1: an element is missing after the comma"),
        ('{"d": [{"t": 1, "x": 1}], "e" 5}', "column 31: ':' is missing"),
        ('{"t": 1, "x": 1}\n{"t": 2, "x": "off"}\n', "row 2 (line 2, column 1): 'off' in column 'x' is not a number"),
        ('[{"t": 1, "x": 1},\n {"a": 2}, {"t": 3, "x": [4]}]', "row 2 (line 2, column 12): '[4]' in column 'x' is not"),
        ('{"t": 1, "x": 1}\n{"t": 2, "x": 1}\n{"t": 2, "x": 1}\n', "row 3 (line 3, column 1): time does not increase"),
        ('{"t": [1, 2, 3], "x": [1, 2]}', "'x' has 2 rows and 't' has 3"),
        (
            '{"t": [1, 2], "x": [[1, 2], [3]]}',
            "line 1, column 29: 2 numbers, as in its first row, are expected here in 'x'",
        ),
        ('{"t": 1, "x": 1' + "0" * 400 + "}\n", "is not a number"),
        ('{"t": 1, "x": 1' + "0" * 5000 + "}\n", "a number with too many digits"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ("", "it is empty"),
        ("7 8 9", "has no list of samples"),
        ('{"t": 1, "y": 1}\n', "no column 'x'"),
        (
            '{"a": [{"t": 1, "x": 1}], "b": [{"t": 1, "x": 1}]}',
            "has several lists of samples: 'a', 'b'; name one of them",
        ),
    ],
)
def test_a_fault_is_named_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    file = opened(tmp_path, text, "x")
    with pytest.raises(InstrumentError) as caught:
        file.look()
    assert message in str(caught.value) and len(str(caught.value)) < 600


@pytest.mark.parametrize("piece", [1 << 18, 7])
def test_what_the_logger_did_not_finish_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    monkeypatch.setattr(json_scan, "PIECE", piece)
    rows = [{"t": k, "x": 0.25 * k, "text": 'a "b" \\ ü', "flag": True} for k in range(5)]
    lines, listed = "\n".join(map(json.dumps, rows)), json.dumps(rows)
    for text in (lines, listed):
        for cut in range(1, 60):
            file = opened(tmp_path, text[:-cut], "x")
            kept = 4 if cut > 1 or text is lines else 5
            assert read(file)["x"] == [0.25 * k for k in range(kept)], text[:-cut]
            assert file.remarks == ("an incomplete sample at the end",)


def test_a_sample_that_is_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_scan, "MAX_VALUE", 1000)
    monkeypatch.setattr(json_scan, "PIECE", 100)
    file = opened(tmp_path, '[{"t": 1, "x": [' + "1, " * 1000 + "1]}]", "x")
    with pytest.raises(InstrumentError, match="line 1, column 2: the value is longer than 1000 characters"):
        file.look()


def test_more_columns_in_memory_than_the_limit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_samples, "MAX_HELD", 1000)
    numbers = list(range(600))
    with pytest.raises(InstrumentError, match="more than 1000 numbers; write it as JSON lines"):
        opened(tmp_path, json.dumps({"t": numbers, "x": numbers}), "x").look()


@pytest.mark.parametrize("name", ["r.jsonl", "r.json"])
def test_the_memory_does_not_grow_with_the_file(tmp_path: Path, name: str) -> None:
    row = '{"t": %d, "x": 0.5, "note": "' + "n" * 400 + '"}'
    lines = (row % k for k in range(60_000))
    text = "\n".join(lines) if name == "r.jsonl" else f"[{', '.join(lines)}]"
    file = opened(tmp_path, text, "x", name=name)
    del text
    tracemalloc.start()
    file.look()
    rows = sum(len(time) for time, _ in file.rows())
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows == 60_000 and (tmp_path / name).stat().st_size > 26e6
    assert most < 15e6
    assert file.about == pytest.approx(60_000, rel=0.1)


def test_the_key_samples_belongs_to_the_format(tmp_path: Path) -> None:
    from planrunner.instruments.formats.choice import FormatChoice
    from planrunner.plan import source

    log = Findings()
    made = FormatChoice().read(source.parse("{type: json, samples: a.b}", "bench.yaml"), log)
    assert made is not None and not log.errors
    (tmp_path / "r.json").write_text('{"a": {"c": []}}', encoding="utf-8")
    file = open_file(tmp_path / "r.json", "r.json", TimeStamps("t"), {}, made)
    with pytest.raises(InstrumentError, match=r"r\.json has no list 'a\.b'; correct the key `samples`"):
        file.look()


@pytest.mark.parametrize("piece", range(1, 40))
def test_values_that_continue_in_the_next_piece_of_the_file(monkeypatch: pytest.MonkeyPatch, piece: int) -> None:
    """A piece of the file may end within a number, such as after the 12 of 12.25e-3."""
    monkeypatch.setattr(json_scan, "PIECE", piece)
    scanner = JsonScanner(io.BytesIO(b'{"a": [0.5, 12.25e-3, -7], "b": 1.5}'), "r.json")
    numbers = []
    for key in scanner.members():
        numbers += [scanner.value() for _ in scanner.elements()] if key == "a" else [scanner.value()]
    assert numbers == [0.5, 12.25e-3, -7, 1.5]
