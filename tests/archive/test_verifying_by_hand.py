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
from planrunner.archive.run_log import ENTRIES, FOLDER, RunLog
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Segment
from planrunner.signing.run_signatures import sign_run
from planrunner.signing.stamping import Stamper
from planrunner.signing.time_stamps import parse_authority
from planrunner.tasks.stamp import stamp_seal
from tests.archive.analyses import add_analysis
from tests.forging import write_run
from tests.signing.test_signatures import ANNA, BEN
from tests.stamp_authority import LocalAuthority

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "verifying-by-hand.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
TOOLS = pytest.mark.skipif(not (shutil.which("jq") and shutil.which("sha256sum")), reason="jq and sha256sum are needed")

OPENSSL = pytest.mark.skipif(
    not (shutil.which("openssl") and shutil.which("basenc")), reason="openssl and basenc are needed"
)


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
        add_analysis(writer.path, {"results.json": b'{"x": %d}' % number})
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


@TOOLS
@OPENSSL
@pytest.mark.slow
def test_signatures_are_verified_by_hand(run: Path) -> None:
    (run.parent / "anna.pem.pub").write_text(f"{ANNA.public.line} anna\n")
    sign_run(GuardedFolder.open(run), run.name, ANNA, "PASSED", "reviewed", "Anna")
    code, words = printed(run, 7)
    assert code == 0 and words[:3] == ["Signature", "Verified", "Successfully"]
    (run.parent / "anna.pem.pub").write_text(f"{BEN.public.line} ben\n")
    assert "Failure" in printed(run, 7)[1]
    (run / "plan.yaml").write_bytes(b"other")
    assert printed(run, 7)[0] != 0


@TOOLS
@OPENSSL
@pytest.mark.slow
def test_time_stamps_are_verified_by_hand(tmp_path: Path) -> None:
    authority = LocalAuthority(tmp_path / "authority")
    try:
        trusted = parse_authority(authority.ca.read_bytes())
        stamper = Stamper(authority.url, trusted, every=0.0)
        run = write_run(tmp_path, analyses=0, witness=stamper)
        stamp_seal(GuardedFolder.open(run), authority.url, trusted)
    finally:
        authority.close()
    shutil.copy(authority.ca, tmp_path / "ca.pem")
    count = len(list((run / "stamps").iterdir()))
    assert printed(run, 8) == (0, ["Verification:", "OK"] * count)
    place = int(min((run / "stamps").iterdir()).name.partition("-after-")[2].removesuffix(".tsr")) - 1
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    lines[place] = lines[place].replace(b'"at":"20', b'"at":"19')
    (run / "journal.jsonl").write_bytes(b"".join(lines))
    (run / "seal.json").write_bytes(b"{}")
    code, words = printed(run, 8)
    assert code != 0 and "not" in words and words.count("OK") < count


@TOOLS
@pytest.mark.skipif(not shutil.which("basenc"), reason="basenc is needed")
@pytest.mark.slow
def test_the_log_is_verified_by_hand(tmp_path: Path) -> None:
    RunLog.create(tmp_path)
    made = [write_run(tmp_path, analyses=0) for _ in range(3)]
    _, (computed, stated) = printed(tmp_path, 9)
    assert computed == stated and len(computed) == 64
    assert printed(tmp_path, 10)[1] == []
    entries = tmp_path / FOLDER / ENTRIES
    lines = entries.read_bytes().splitlines(keepends=True)
    entries.write_bytes(b"".join(lines[:-1]))
    _, (computed, stated) = printed(tmp_path, 9)
    assert computed != stated
    shutil.rmtree(made[0])
    assert {"missing:", made[0].name, f"{made[2].name}/"} <= set(printed(tmp_path, 10)[1])


@TOOLS
@pytest.mark.skipif(not shutil.which("basenc"), reason="basenc is needed")
@pytest.mark.slow
def test_unsealed_and_retired_runs_are_no_faults_by_hand(tmp_path: Path) -> None:
    log = RunLog.create(tmp_path)
    away = write_run(tmp_path, analyses=0)
    log.append("retired", away.name, why="sent to the customer")
    shutil.rmtree(away)
    with RunWriter.create(tmp_path, "p", b"plan", b"bench", {}, "flushed") as unfinished:
        pass
    assert printed(tmp_path, 10)[1] == ["not", "sealed:", f"{unfinished.path.name}/"]
    assert printed(tmp_path, 11)[1][:1] == [f"{away.name}:"]
    write_run(tmp_path, analyses=0)
    shutil.rmtree(unfinished.path)
    assert printed(tmp_path, 10)[1] == ["missing:", unfinished.path.name]


def test_every_test_named_in_the_compliance_page_exists() -> None:
    page = (ROOT / "docs" / "compliance.md").read_text(encoding="utf-8")
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", page)
    assert len(named) > 15
    for file, test in named:
        path = ROOT / file
        assert path.is_file(), file
        assert not test or f"def {test}(" in path.read_text(encoding="utf-8"), f"{file}::{test}"
