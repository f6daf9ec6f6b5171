"""The diagnosis answers blind cases in its output contract, and better than what a user would reach for instead."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.blind import campaign, folder
from tests.blind.generator import draw, make
from tests.blind.product import closure_and_truth, observation
from tests.blind.scoring import Scored

CONTRACT = {"gap", "where", "posterior", "verdict", "ambiguity_set", "absorbed", "parameters", "closure", "next"}
SETUPS = (("poor", "mems"), ("rates", "fog"))
KINDS = ("none", "single", "single", "single", "single", "pair", "unknown", "none")


def sample(here: Path, setups: tuple[tuple[str, str], ...], seed: int) -> dict[str, dict]:
    folder.write_setups(here)
    rng = np.random.default_rng(seed)
    for n, (plan, sensor) in enumerate(setups):
        for k, kind in enumerate(KINDS):
            folder.write_case(here, draw(f"case-{n}{k}", plan, sensor, kind, rng), seed)
    folder.commit(here)
    return folder.verified_labels(here)


@pytest.mark.slow
def test_a_case_becomes_an_observation(tmp_path: Path) -> None:
    """Units, signs and noise are carried over: the product's nominal stimulus is the generator's."""
    folder.write_setups(tmp_path)
    for sensor in ("mems", "fog"):
        folder.write_case(tmp_path, draw("case", "rocking", sensor, "none", np.random.default_rng(3)), 3)
        shown = folder.shown(tmp_path, "case")
        seen, felt = observation(shown), shown.schedule.nominal
        assert np.degrees(seen.omega) == pytest.approx(felt.rate, abs=2e-3)
        assert seen.force / 9.80154 == pytest.approx(felt.force, abs=1e-6)
        assert np.degrees(seen.values[:, :3]) == pytest.approx(shown.outputs[:, :3])
        white = np.array([channel.white for channel in seen.channels]) * np.sqrt(shown.bench["sampling_hz"])
        assert white[:3] == pytest.approx(np.radians(shown.sensor.sigma()[:3]))
        assert white[3:] == pytest.approx(shown.sensor.sigma()[3:])


@pytest.mark.slow
def test_answers_keep_the_contract(tmp_path: Path) -> None:
    labels = sample(tmp_path, SETUPS[:1], 4)
    campaign.answer_all(tmp_path, ["planrunner"])
    for name, answer in folder.answers(tmp_path, "planrunner").items():
        assert name in labels and answer.keys() >= CONTRACT, answer.get("error")
        assert sum(answer["posterior"].values()) == pytest.approx(1, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("number", [9, 59])  # a single effect and a pair, both strong, under the smallest plan
def test_a_closure_is_compared_with_that_of_the_known_truth(number: int, tmp_path: Path) -> None:
    folder.write_setups(tmp_path)
    case = make(77, number)
    folder.write_case(tmp_path, case, 77)
    (tmp_path / "sealed" / "seed").write_text("77", encoding="utf-8")
    closure = closure_and_truth(folder.shown(tmp_path, case.name))["closure"]
    assert min(entry["lambda"] for entry in case.label["entries"]) > 900
    assert 0.7 < closure["true"] <= closure["told"] + 0.02
    assert closure["told"] < 1


@pytest.mark.slow
def test_it_is_right_more_often_than_what_it_replaces(tmp_path: Path) -> None:
    labels = sample(tmp_path, SETUPS, 5)
    right = {}
    for who in ("planrunner", "whitened-bic", "stepwise-bic", "stlsq"):
        campaign.answer_all(tmp_path, [who])
        scored = [Scored(labels[name], answer) for name, answer in folder.answers(tmp_path, who).items()]
        assert not any(case.failed for case in scored), who
        right[who] = sum(case.right for case in scored)
    assert right["planrunner"] > max(count for who, count in right.items() if who != "planrunner"), right
