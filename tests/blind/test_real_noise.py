"""Cases with real noise: what of the recordings remains in them, and that the campaign makes and diagnoses them like the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.blind import campaign, folder, generator, real
from tests.blind.device import ideal
from tests.blind.generator import make
from tests.blind.plans import PLANS
from tests.blind.product import diagnose

pytestmark = pytest.mark.skipif(not real.DATA.is_dir(), reason="no recordings in ../shared/data")


def test_allan_deviations_worked_by_hand() -> None:
    values = np.array([[0.0], [2.0], [4.0], [0.0]])
    assert real.allan_deviation(values, 1)[0] ** 2 == pytest.approx((4 + 4 + 16) / 3 / 2)
    assert real.allan_deviation(values, 2)[0] ** 2 == pytest.approx((2 - 1) ** 2 / 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mpu6050", "ring_laser", "beside_a_turning_one"])
def test_a_cut_keeps_the_noise_of_the_recording(name: str) -> None:
    """One level a triad, no drift; the ring laser's rounding stays anti-correlated."""
    found = real.background(name)
    whole = found.values
    assert whole.std(axis=0).reshape(-1, 3) == pytest.approx(np.repeat(whole.std(axis=0)[::3, None], 3, 1))
    piece = found.cut(20_000, np.random.default_rng(1))
    assert piece.std(axis=0) == pytest.approx(np.hypot(whole.std(axis=0), found.steps / np.sqrt(12)), rel=0.15)
    following = [np.corrcoef(column[1:], column[:-1])[0, 1] for column in piece.T]
    if name == "ring_laser":
        assert following[0] == pytest.approx(-0.75, abs=0.05)  # as its data's description has it
    with pytest.raises(ValueError, match="are wanted of a recording of"):
        found.cut(len(whole) + 1, np.random.default_rng(1))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mpu6050", "ring_laser", "beside_a_turning_one"])
def test_no_slow_part_of_the_noise_is_missing(name: str) -> None:
    """The slowest cosines of the noise are as large as the next slower ones, within what a few random numbers allow."""
    found = real.background(name)
    ratios = []
    for seed in range(40):
        piece = found.cut(len(found.values), np.random.default_rng(seed))
        energy = (real._polynomials(len(piece), range(1, 11)).T @ piece) ** 2
        ratios.append(energy[:4].mean(axis=0) / energy[4:].mean(axis=0))
    without = (real._polynomials(len(found.values), range(1, 11)).T @ found.values) ** 2
    assert np.mean(without[:4], axis=0).sum() < 0.3 * np.mean(without[4:], axis=0).sum()
    assert 0.4 < np.exp(np.mean(np.log(np.array(ratios).mean(axis=0)))) < 2.5


def test_noise_on_a_lattice_gets_no_coarser_count_of_its_order() -> None:
    """The gyros of the ring-laser IMU read multiples of one value. Rounding them to counts of that order gives errors that depend on the
    signal and that a mean keeps; noise of the other sensors dithers such counts."""
    pieces = [
        np.fromfile(real.DATA / "ln100" / f"x_LN100_{way}.ins", "<f8").reshape(-1, 7)[:, 1:4] for way in ("up", "down")
    ]
    turns = [np.abs(np.exp(2j * np.pi * piece / real.LSB_RING_LASER).mean(axis=0)) for piece in pieces]
    assert np.min(turns) > 0.99
    kind = generator.KINDS["gyro_quantization"]
    for name, possible in (("ring_laser", False), ("beside_a_turning_one", True)):
        sensor = real.sensor_called(name)
        work = generator.Work(generator.signatures("poor", name), real.true_factors(name), ideal(sensor))
        made = [generator._of_strength(kind, np.ones(1), (), float(energy), work) for energy in (10, 30, 90)]
        assert [fault is not None for fault in made] == [possible] * 3


@pytest.mark.slow
def test_every_plan_is_no_longer_than_its_recording() -> None:
    for plan, name in real.SETUPS:
        sensor = real.sensor_called(name)
        assert sum(round(s.duration * sensor.sampling) for s in PLANS[plan]) <= len(real.background(name).values)


@pytest.mark.slow
def test_cases_are_made_and_answered(tmp_path: Path) -> None:
    folder.write_setups(tmp_path, real_noise=True)
    for number in (1, 2):
        case = generator.draw(f"case-{number}", "poor", "mpu6050", "single", np.random.default_rng(number))
        folder.write_case(tmp_path, case, 3)
    folder.commit(tmp_path)
    campaign.answer_all(tmp_path, ["planrunner"])
    for name, answer in folder.answers(tmp_path, "planrunner").items():
        assert "verdict" in answer, answer.get("error")
        label = folder.verified_labels(tmp_path)[name]
        assert label["noise_factors"] == list(real.true_factors("mpu6050"))
    shown = folder.shown(tmp_path, "case-1")
    steps = np.diff(np.unique(shown.columns["gyro_x_deg_per_s"]))
    assert steps.min() == pytest.approx(shown.bench["channels"]["gyro_x"]["resolution"])


@pytest.mark.parametrize("name", ["mpu6050", "ring_laser", "beside_a_turning_one"])
def test_more_noise_is_more_than_a_wrong_declaration_explains(name: str) -> None:
    """By the scatter of the samples, which is what is declared, whatever the level of the noise after a second."""
    work = generator.Work(generator.signatures("poor", name), real.true_factors(name), ideal(real.sensor_called(name)))
    kind, energy = generator.KINDS["gyro_noise_excess"], 400.0
    fault = generator._of_strength(kind, np.ones(1), (), energy, work)
    assert fault is not None and generator.strength_of(work, fault) == pytest.approx(energy)
    schedule, sensor = work.around.schedule, work.around.sensor
    factors = np.repeat(work.factors, 3) * np.r_[np.full(3, 1 + fault.theta[0]), np.ones(3)][: 3 * len(sensor.triads)]
    scatter = real.noise(schedule, sensor, factors, np.random.default_rng(5)).std(axis=0)[:3].mean()
    declared = sensor.sigma()[0]
    assert scatter / declared == pytest.approx(2 * generator.excess_ratio(energy), rel=0.15)


@pytest.mark.slow
def test_a_dead_zone_whose_search_alternates_stands_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The biases lie within the dead zone, so its width and the biases must be found together. An asymmetry was named beside it. The
    noise is that of the case in which the search alternated: without the drift that now takes the place of the recording's own."""

    def cut(found: real.Background, count: int, rng: np.random.Generator) -> np.ndarray:
        first = int(rng.integers(len(found.values) - count + 1))
        return found.values[first : first + count] + found.steps * rng.uniform(-0.5, 0.5, (count, len(found.steps)))

    monkeypatch.setattr(real.Background, "cut", cut)
    folder.write_setups(tmp_path, real_noise=True)
    case = make(8301, 19, real_noise=True)
    folder.write_case(tmp_path, case, 8301)
    found = diagnose(folder.shown(tmp_path, case.name))
    assert [entry["effect"] for entry in case.label["entries"]] == ["gyro_dead_zone"]
    assert found["verdict"]["effects"] == ["gyro_dead_zone"]
    assert found["posterior"]["gyro_dead_zone"] > 0.9
