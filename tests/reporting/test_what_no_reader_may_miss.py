"""What stands beside every verdict: that samples are simulated or played back; what ± means; who, when, how long, which analysis."""

from __future__ import annotations

import functools
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import certificate_example
import pytest
import reporting_example as example
from diagnosis_example import diagnosis
from printed_sheets import printed_sheets

from planrunner.bench.model import models, read_bench, shipped_benches
from planrunner.cli import main
from planrunner.instruments.models import DataOrigin
from planrunner.reporting.diagnosis_page import DiagnosisContext, render_page
from planrunner.reporting.rounding import in_parentheses
from planrunner.reporting.view import render_report

ROOT = Path(__file__).resolve().parents[2]


@functools.cache
def simulated_page(name: str) -> str:
    """A page of a run on simulated instruments, long enough for several sheets of paper."""
    if name == "diagnosis":
        return render_page(DiagnosisContext("Plan", diagnosis("pair"), origin="simulated"))
    if name == "report":
        context = replace(example.context(), origin="simulated", warnings=("A warning. " * 60,) * 8)
        return render_report(context, "report.html")
    certificate = certificate_example.context(
        simulated=True, told={**certificate_example.TOLD, "opinions": "An opinion. " * 300}
    )
    return render_report(certificate, f"certificate{'.zh' if name.endswith('Chinese') else ''}.html")


PAGES = ("report", "certificate", "certificate in Chinese", "diagnosis")
STAMP = {"certificate": "Simulated: not a calibration", "certificate in Chinese": "仿真结果：不构成校准"}


def test_the_stamp_stands_beside_the_verdict_and_nothing_is_green() -> None:
    for name in PAGES:
        page = simulated_page(name)
        body = page[page.index("<body") :]
        assert body.startswith('<body class="simulated">'), name
        assert body.index('class="stamp alarming"') < body.index("<h1"), "at the head of every sheet"
        verdict = body[body.index('class="verdict') :]
        assert STAMP.get(name, "SIMULATED") in verdict[: verdict.index("</div>")], name
    others: tuple[tuple[DataOrigin | None, str | None], ...] = (
        ("measured", None),
        (None, None),
        ("replayed", "PLAYED BACK"),
    )
    for origin, word in others:
        page = render_report(replace(example.context(), origin=origin), "report.html")
        assert "SIMULATED" not in page and 'class="simulated"' not in page
        assert ("PLAYED BACK" in page) == (word is not None)


def test_the_summary_says_it_in_its_first_line_of_text() -> None:
    lines = render_report(replace(example.context(), origin="simulated"), "summary.md").splitlines()
    assert lines[2].startswith("**SIMULATED")


@pytest.mark.parametrize("name", PAGES)
def test_every_printed_sheet_carries_the_stamp(name: str, tmp_path: Path) -> None:
    sheets = printed_sheets(simulated_page(name), tmp_path)
    assert len(sheets) > 1
    word = "".join(STAMP.get(name, "SIMULATED").split())
    for place, text in enumerate(sheets, 1):
        assert word in "".join(text.split()), f"sheet {place} of {len(sheets)}"


class Tables(HTMLParser):
    """Of every table its column titles, and of every cell its column and what a narrow page puts before it."""

    def __init__(self) -> None:
        super().__init__()
        self.titles: list[list[str]] = []
        self.cells: list[tuple[int, int, str, str]] = []  # table, column, data-before, text
        self._where = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "table" and given.get("class") != "sheet":
            self.titles.append([])
        elif tag == "thead":
            self._where = "head" if given.get("class") != "running" else ""
        elif tag in ("tbody", "tfoot"):
            self._where = "body"
        elif tag == "tr":
            self._column = -1
        elif tag in ("th", "td") and self.titles:
            self._column += 1
            if self._where == "head":
                self.titles[-1].append("")
            else:
                self.cells.append((len(self.titles) - 1, self._column, given.get("data-before") or "", ""))

    def handle_data(self, data: str) -> None:
        if not self.titles:
            return
        if self._where == "head" and self.titles[-1]:
            self.titles[-1][-1] += data
        elif self.cells and self._where == "body":
            table, column, before, text = self.cells[-1]
            self.cells[-1] = (table, column, before, text + data)


@pytest.mark.parametrize("name", ["report", "certificate"])
def test_plus_minus_is_the_expanded_uncertainty_at_every_width_and_k_is_stated(name: str) -> None:
    """Narrow pages put `data-before` in place of the column's title."""
    pages = {"report": example.context(), "certificate": certificate_example.context()}
    read = Tables()
    read.feed(render_report(pages[name], f"{name}.html"))
    narrowed = {table for table, _, before, _ in read.cells if before}  # the others keep their titles
    seen = 0
    for table, column, before, text in read.cells:
        titles = read.titles[table]
        title = " ".join(titles[column].split()) if column < len(titles) else ""
        if title.startswith("± U"):
            seen += 1
            assert before == "± ", (title, before)
            assert "k" in [other.strip() for other in titles[column + 1 :]], titles
        else:
            assert "±" not in before, (title, before)
        if table in narrowed and text.strip() and (title.startswith("u") or "uncertainty u" in title):
            assert before.startswith("u"), (title, before)
        if re.match(r"-?[0-9]", text.strip()):
            assert "±" not in text, (title, text)
    assert seen > 10


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (1.23456, 0.0021, "1.2346(21)"),
        (54.558, 0.0132, "54.558(13)"),
        (12.41, 1.3, "12.4(1.3)"),
        (12400.0, 1300.0, "12400(1300)"),
        (1.5e-7, 1.2e-10, "1.5000(12)e-7"),
        (2.5, 0.0, "2.5"),
    ],
)
def test_standard_uncertainties_in_the_last_digits(value: float, u: float, text: str) -> None:
    """The first as in JCGM 100:2008, 7.2.2."""
    assert in_parentheses(value, u) == text


def test_where_the_samples_of_every_shipped_bench_come_from() -> None:
    """By what their files declare: playing back, simulated in this program, or in the process behind their addresses."""
    for name in shipped_benches():
        bench, _, _ = read_bench(name)
        plays = any(entry.driver == "recording" for entry in bench.instruments.values())
        assert models(bench).origin == ("replayed" if plays else "simulated"), name
    lab, _, _ = read_bench("lab_simulated")
    assert models(replace(lab, simulation=None)).origin == "measured"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A simulated run and one that played a recording back, each estimated twice."""
    folder = tmp_path_factory.mktemp("pages")
    flagship = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    (folder / "plan.yaml").write_text(flagship.replace("dwell: 2 min", "dwell: 10 s"), encoding="utf-8")
    given = ["--set", "device_serial=FG-7", "--set", "operator=R. Example", "--quiet", "--flushed"]
    answers = str(ROOT / "plans" / "self_test")
    commands = {
        "simulated": [str(folder / "plan.yaml"), *given],
        "replayed": [str(ROOT / "plans" / "self_test" / "norris.yaml"), "--quiet", "--flushed", "--data", answers],
    }
    made = {}
    for name, words in commands.items():
        assert main(["run", *words, "--runs", str(folder / name)]) in (0, 1)
        (made[name],) = [path for path in (folder / name).iterdir() if path.is_dir()]
        assert main(["estimate", str(made[name])]) in (0, 1)
        assert main(["report", str(made[name]), "report.html", "summary.md"]) == 0
    return made


def head(run: Path, number: int, file: str = "report.html") -> str:
    page = (run / "analyses" / str(number) / file).read_text(encoding="utf-8")
    return page[: page.index("Run, bench and instruments")]


def test_what_a_reader_looks_for_first_stands_first(runs: dict[str, Path]) -> None:
    created = json.loads((runs["simulated"] / "run.json").read_text(encoding="utf-8"))["created"]
    for file in ("report.html", "summary.md"):
        top = head(runs["simulated"], 3, file)
        for text in ("FG-7", "R. Example", created[:10], "Duration", "3 (of 3"):
            assert text in top, (file, text)


def test_results_and_pages_carry_where_the_samples_come_from(runs: dict[str, Path]) -> None:
    for origin, run in runs.items():
        results = json.loads((run / "analyses" / "1" / "results.json").read_text(encoding="utf-8"))
        assert results["origin"] == origin
    assert "SIMULATED" in head(runs["simulated"], 3)
    assert "PLAYED BACK" in head(runs["replayed"], 3)


def test_a_seed_is_shown_only_where_it_decided_something(runs: dict[str, Path]) -> None:
    pages = {name: (run / "analyses" / "3" / "report.html").read_text(encoding="utf-8") for name, run in runs.items()}
    assert "Seed of simulated noise" in pages["simulated"]
    assert not re.search(r"\bseed\b", pages["replayed"], re.IGNORECASE)


def test_the_terminal_ends_with_the_verdict_and_its_stamp(
    runs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    main(["estimate", str(runs["simulated"])])
    out = capsys.readouterr().out
    assert out.index("SF_X") < out.index("SIMULATED") < out.index("Passed")
