"""The commands of docs/verifying-by-hand.md find nothing in an untouched run and something in a changed one; docs/compliance.md names tests
that exist."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Segment

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "verifying-by-hand.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
TOOLS = pytest.mark.skipif(not (shutil.which("jq") and shutil.which("sha256sum")), reason="jq and sha256sum are needed")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    with RunWriter.create(tmp_path, "p", b"plan", b"bench", {"operator": "Ä"}, "flushed") as writer:
        for index in range(2):
            writer.begin(
                Segment(index, f"P{index + 1}", None, "unknown", Rest(), dwell=1.0), float(index), {"x": "deg/s"}
            )
            writer.append(Block(index + np.arange(20) / 20, {"x": np.ones(20)}), index + 1.0)
            writer.acknowledge(index + 1.0, {}, {})
        writer.finish()
    for number in range(2):
        RunReader.open(writer.path).add_analysis({"results.json": b'{"x": %d}' % number})
    return writer.path


def printed(run: Path, number: int) -> tuple[int, list[str]]:
    """Exit code and lines of the commands of a step, counted from 1."""
    done = subprocess.run(["sh", "-c", BLOCKS[number - 1]], cwd=run, capture_output=True, text=True)
    return done.returncode, done.stdout.split()


@TOOLS
@pytest.mark.slow
def test_an_untouched_run_is_verified_by_hand(run: Path) -> None:
    assert printed(run, 1) == (0, [])
    _, (stated, computed) = printed(run, 2)
    assert stated == computed
    _, (head,) = printed(run, 3)
    _, (sealed, events, lines) = printed(run, 4)
    assert (head, events) == (sealed, lines)
    assert printed(run, 5) == (0, [])
    assert printed(run, 6) == (0, ["true", "true"])


@TOOLS
@pytest.mark.slow
def test_changes_are_found_by_hand(run: Path) -> None:
    samples = run / "segments" / "0001-P1.parquet"
    samples.write_bytes(samples.read_bytes()[:-1])
    assert printed(run, 1)[0] != 0 and printed(run, 5)[0] != 0
    seal = run / "seal.json"
    seal.write_bytes(seal.read_bytes().replace(b'"sealed": "20', b'"sealed": "19'))
    _, (stated, computed) = printed(run, 2)
    assert stated != computed
    assert printed(run, 6)[1] == ["false", "false"]
    journal = run / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b'"P1"', b'"P9"', 1))
    assert len(printed(run, 3)[1]) > 1


def test_every_test_named_in_the_compliance_page_exists() -> None:
    page = (ROOT / "docs" / "compliance.md").read_text(encoding="utf-8")
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", page)
    assert len(named) > 15
    for file, test in named:
        path = ROOT / file
        assert path.is_file(), file
        assert not test or f"def {test}(" in path.read_text(encoding="utf-8"), f"{file}::{test}"
