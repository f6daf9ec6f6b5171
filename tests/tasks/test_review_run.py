"""The review page of a run: deviations first, every link leads somewhere, and hostile texts stay text."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from planrunner.cli import main
from planrunner.reporting.review_page import render_review
from planrunner.tasks.amendment import Amendment
from planrunner.tasks.estimate import analyse_run
from planrunner.tasks.review_run import review_of

ROOT = Path(__file__).parents[2]
FLAGSHIP = ROOT / "plans" / "flexure_gyro_eight_position.yaml"
HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reviewed")
    plan = folder / "plan.yaml"
    plan.write_text(FLAGSHIP.read_text(encoding="utf-8").replace("dwell: 2 min", "dwell: 2 s"), encoding="utf-8")
    given = ["--set", "device_serial=1", "--set", f"operator={HOSTILE}", "--quiet", "--flushed", "--runs", str(folder)]
    assert main(["run", str(plan), *given]) in (0, 1)
    (run,) = folder.glob("2*")
    assert main(["resume", str(run), "--retake", "P3", "--reason", HOSTILE, "--quiet"]) in (0, 1)
    analyse_run(run, amendment=Amendment(HOSTILE, "another <b>reason</b>"))
    return run


def test_the_deviations_come_first(original: Path) -> None:
    context = review_of(original)
    kinds = [one.kind for one in context.deviations]
    assert {"simulated", "recorded again", "amendment"} <= set(kinds)
    assert next(one for one in context.deviations if one.kind == "recorded again").segment == "P3"
    assert "reopened" in [kind for _, kind, _ in context.events]
    page = render_review(context)
    assert (
        page.index('id="deviations"')
        < page.index('id="limits"')
        < page.index('id="segments"')
        < page.index('id="files"')
    )
    assert "Not to be released" in page


def test_every_link_leads_somewhere_and_every_file_has_its_digest(original: Path) -> None:
    page = render_review(review_of(original))
    places = re.findall(r'\bid="([^"]+)"', page)
    links = re.findall(r'href="#([^"]+)"', page)
    assert len(set(places)) == len(places)
    assert len(links) > 30 and set(links) <= set(places)
    seal = json.loads((original / "seal.json").read_bytes())
    assert all(value in page for name, value in seal["files"].items() if name != "journal.jsonl")


def test_hostile_texts_stay_text(original: Path) -> None:
    page = render_review(review_of(original))
    assert "<script" not in page and "<img" not in page and "<b>reason" not in page
    assert "&lt;script&gt;" in page
    assert "default-src &#39;none&#39;" in page or "default-src 'none'" in page


def test_every_value_of_the_page_has_its_coverage_factor_and_is_no_wider_than_a_phone(original: Path) -> None:
    page = render_review(review_of(original))
    numbers = [table for table in re.findall(r"<table.*?</table>", page, re.DOTALL) if "± U" in table]
    assert len(numbers) > 1
    for table in numbers:
        assert re.match(r'<table class="lines\b', table), table[:100]
        assert table.count('data-before="± "') == table.count('data-before="k = "') > 0


def test_the_command_lists_and_writes(original: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "review.html"
    assert main(["review", str(original), "--html", str(file)]) == 0
    said = capsys.readouterr().out
    assert "recorded again (P3)" in said and said.rstrip().endswith("review.html") and file.stat().st_size > 10_000
    assert main(["review", str(original), "--json", "--analysis", "1"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "newer analysis" in [one["kind"] for one in found["deviations"]]
    assert main(["review", str(original), "--analysis", "9"]) == 2


def test_a_changed_run_has_no_review_page(original: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(original, tmp_path / "run"))
    (run / "plan.yaml").write_bytes(b"")
    assert main(["review", str(run)]) == 4
