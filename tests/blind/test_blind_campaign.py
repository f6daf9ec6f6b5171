"""Commitments hold, a campaign goes on where it stopped, and its results do not depend on who does the work."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from dask.distributed import LocalCluster

from planrunner.base.workers import Workers
from tests.blind import baselines, campaign, commitment, folder, generator, oracle
from tests.blind.__main__ import main
from tests.blind.device import SENSORS
from tests.blind.folder import Shown
from tests.blind.generator import draw
from tests.blind.scoring import Scored

SEED = 20  # its first cases include both sensor types


def nothing(shown: Shown) -> dict:
    """An answerer that looks at the data and says none."""
    assert len(shown.columns["time_s"]) == len(shown.schedule.time)
    return {"verdict": {"kind": "none", "effects": [], "class": []}}


def failing(shown: Shown) -> dict:
    raise ValueError(f"cannot read {shown.name}")


NOTHING = f"{__name__}:nothing"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine cases under the smallest plan, made as a campaign writes them."""
    here = tmp_path_factory.mktemp("blind")
    folder.write_setups(here)
    rng = np.random.default_rng(7)
    kinds = ("none", "none", "single", "single", "single", "single", "pair", "unknown", "unknown")
    for number, kind in enumerate(kinds):
        folder.write_case(here, draw(f"case-{number:05d}", "poor", "mems", kind, rng), SEED)
    folder.commit(here)
    return here


def test_a_commitment_worked_by_hand() -> None:
    label = {"effects": ["b", "a"], "case": "x"}
    text = '{"case":"x","effects":["b","a"]}'
    assert commitment.canonical(label) == text
    assert commitment.commitment("salt", label) == hashlib.sha256(b"salt" + text.encode()).hexdigest()


def test_commitments_are_written_and_verified(made: Path) -> None:
    lines = (made / "commitments.txt").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 9 and all(len(line.split()[0]) == 64 for line in lines)
    assert len(folder.verified_labels(made)) == 9


def test_a_changed_label_breaks_the_seal(made: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(made, copy)
    sealed = copy / "sealed" / "case-00002.json"
    held = json.loads(sealed.read_text(encoding="utf-8"))
    held["label"]["effects"] = ["table_tilt", "gyro_warm_up"]
    sealed.write_text(json.dumps(held), encoding="utf-8")
    with pytest.raises(commitment.BrokenSealError, match="case-00002"):
        folder.verified_labels(copy)
    sealed.unlink()
    with pytest.raises(commitment.BrokenSealError, match="different cases"):
        folder.verified_labels(copy)
    assert main(["score", str(copy)]) == 2


def test_what_is_shown_says_nothing_of_the_truth(made: Path) -> None:
    shown = folder.shown(made, "case-00002")
    label = folder.verified_labels(made)["case-00002"]
    text = (shown.folder / "case.json").read_text(encoding="utf-8") + json.dumps(shown.bench)
    assert label["effects"] and not any(name in text for name in label["effects"])
    assert sorted(path.name for path in shown.folder.iterdir()) == ["case.json", "recording.parquet"]


def test_answers_go_on_where_they_stopped_and_failures_are_counted(made: Path) -> None:
    campaign.answer_all(made, [NOTHING])
    label = NOTHING.replace(":", ".")
    path = folder.answer_file(made, label, "case-00000")
    first = path.read_text(encoding="utf-8")
    folder.answer_file(made, label, "case-00001").unlink()
    told: list[str] = []
    campaign.answer_all(made, [NOTHING], tell=told.append)
    assert told == [f"9 of 9 answered by {NOTHING}"]
    assert path.read_text(encoding="utf-8") == first
    campaign.answer_all(made, [f"{__name__}:failing"])
    failed = folder.answers(made, f"{__name__}.failing")
    assert failed["case-00003"]["error"] == "ValueError: cannot read case-00003"


@pytest.mark.slow
def test_a_campaign_is_the_same_on_one_and_two_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "assigned", lambda seed, n, real_noise=False: ("poor", "mems", "none"))
    monkeypatch.setattr("tests.blind.generator.assigned", lambda seed, n, real_noise=False: ("poor", "mems", "none"))
    monkeypatch.setattr(campaign, "BATCH", 2)
    campaign.make_all(tmp_path / "one", 2, SEED)
    campaign.make_all(tmp_path / "one", 4, SEED)  # goes on
    here = {
        "host": "127.0.0.1",
        "dashboard_address": None,
        "processes": False,
        "protocol": "tcp",
    }  # threads, which see what is patched
    with LocalCluster(n_workers=2, threads_per_worker=1, **here) as cluster:
        campaign.make_all(tmp_path / "two", 4, SEED, Workers(1, cluster.scheduler_address))
    one, two = ((tmp_path / name / "commitments.txt").read_text(encoding="utf-8") for name in ("one", "two"))
    assert one == two and len(one.splitlines()) == 4
    for name in folder.made(tmp_path / "one"):
        tables = [folder.shown(tmp_path / where, name).columns for where in ("one", "two")]
        assert all((tables[0][key] == tables[1][key]).all() for key in tables[0])
    with pytest.raises(ValueError, match="another seed"):
        campaign.make_all(tmp_path / "one", 4, SEED + 1)


@pytest.mark.slow
def test_processes_of_this_machine_answer_alike(made: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(made, copy)
    campaign.answer_all(made, ["whitened-bic"])
    campaign.answer_all(copy, ["whitened-bic"], Workers(2))
    answers = [folder.answers(where, "whitened-bic") for where in (made, copy)]
    for one, two in zip(*(sorted(found.items()) for found in answers), strict=True):
        assert one[0] == two[0]
        assert {**one[1], "seconds": 0} == {**two[1], "seconds": 0}


def known(here: Path, *effects: str) -> Shown:
    """A case under the smallest plan with these effects, each at λ = 900, or 100 for a resolution."""
    mems = SENSORS["mems"]
    around, rng = generator.signatures("poor", "mems"), np.random.default_rng(6)
    work = generator.Work(around, (1.0, 1.0), generator.random_device(mems, rng))
    faults = [
        generator.one_effect(work, [effect], 100.0 if effect == "gyro_quantization" else 900.0, rng)
        for effect in effects
    ]
    columns = generator.simulate(work, faults, False, rng)
    label = generator.label_of("known", "pair" if len(effects) == 2 else "single", faults, work, False)
    folder.write_setups(here)
    case = generator.Case("known", "poor", "mems", columns, label, tuple(faults), work.device)
    folder.write_case(here, case, SEED)
    return folder.shown(here, "known")


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        ("gyro_g_sensitivity",),
        ("gyro_scale_asymmetry",),
        ("gyro_bias_random_walk",),
        ("gyro_dead_zone",),
        ("gyro_quantization",),
        ("gyro_noise_excess",),
        ("gyro_scale_asymmetry", "lever_arm"),
    ],
    ids="+".join,
)
def test_the_oracle_finds_what_is_strong(effects: tuple[str, ...], tmp_path: Path) -> None:
    shown = known(tmp_path, *effects)
    assert Scored(oracle.label_of(shown), oracle.diagnose(shown)).right


@pytest.mark.slow
def test_the_oracle_leaves_none_alone_and_its_probabilities_add_up(made: Path) -> None:
    for name in ("case-00000", "case-00001"):
        answer = oracle.diagnose(folder.shown(made, name))
        assert answer["verdict"]["kind"] == "none"
        assert sum(answer["posterior"].values()) == pytest.approx(1, abs=1e-3)


@pytest.mark.slow
def test_the_oracle_closes_what_it_refits(tmp_path: Path) -> None:
    closure = oracle.diagnose(known(tmp_path, "gyro_scale_asymmetry"))["closure"]
    assert closure["before"] == pytest.approx(30, rel=0.05)  # √λ
    assert 0.8 < closure["shrinks_by"] < 1  # three parameters leave about √3 of 30


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stepwise_bic", "whitened_bic", "lasso"])
def test_baselines_find_a_strong_effect_and_have_no_word_for_unknown(name: str, tmp_path: Path) -> None:
    answer = getattr(baselines, name)(known(tmp_path, "gyro_scale_asymmetry"))
    assert "gyro_scale_asymmetry" in answer["verdict"]["effects"]
    assert answer["verdict"]["kind"] in ("effect", "pair") and "posterior" not in answer


@pytest.mark.slow
def test_thresholded_least_squares_keeps_what_is_large(made: Path) -> None:
    """It names what it keeps of all columns at once; on pure noise that is still something."""
    answer = baselines.stlsq(folder.shown(made, "case-00000"))
    assert answer["verdict"]["kind"] != "none"


def test_score_is_a_table_and_a_file(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    campaign.answer_all(made, [NOTHING])
    assert main(["score", str(made), "--json", str(tmp_path / "s.json")]) == 0
    assert "false alarm: all" in capsys.readouterr().out
    figures = json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))
    assert figures["answers"][NOTHING.replace(":", ".")]["false alarm"]["all"]["hits"] == 0


@pytest.mark.slow
def test_the_first_cases_alone_are_answered_and_scored(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    some = tmp_path / "some"
    shutil.copytree(made, some, ignore=shutil.ignore_patterns("answers"))
    assert main(["answer", str(some), "--by", NOTHING, "--first", "4"]) == 0
    assert list(folder.answers(some, NOTHING.replace(":", "."))) == [f"case-{k:05d}" for k in range(4)]
    assert main(["score", str(some), "--first", "3"]) == 0
    assert capsys.readouterr().out.startswith("3 cases, commitments verified")
