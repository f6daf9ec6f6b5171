"""Recordings as they come: gaps, NaN, short records, several segments, long records, chosen averaging times, bad requests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from recorded import figure, from_samples, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.allan import phase as allan_phase
from planrunner.estimators.allan.allan_deviation import AllanDeviation, AllanDeviationParameters
from planrunner.estimators.allan.phase import read_phase
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, EstimationError
from planrunner.estimators.method import designed
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity

SITE = Site(math.radians(40.0))


def record(values: np.ndarray, time: np.ndarray | None = None, label: str = "rest", rows: int = 97) -> RecordedSegment:
    stamps = np.arange(len(values)) * 0.5 if time is None else time
    return from_samples(segment(label), stamps, {"gyro": np.asarray(values, float)}, {"gyro": "pulse/s"}, rows=rows)


def run(*segments: RecordedSegment, **keys: Any) -> Estimate:
    parameters = AllanDeviationParameters(outputs=("gyro",), **keys)
    return AllanDeviation().estimate(EstimateRequest("noise", segments, parameters, SITE, sensor("gyro")))


def white(samples: int, seed: int = 0) -> np.ndarray:
    return 100 + np.random.default_rng(seed).standard_normal(samples)


@pytest.mark.parametrize("rows", [1, 7, 97, 5000])
def test_phase_does_not_depend_on_blocks(rows: int) -> None:
    values = white(1000)
    phase = read_phase([record(values, rows=rows)], "gyro")
    assert len(phase.runs) == 1
    assert phase.interval == pytest.approx(0.5)
    assert np.diff(phase.runs[0]) == pytest.approx(values - values.mean(), abs=1e-10)


@pytest.mark.parametrize("rows", [1, 7, 50, 5000])
def test_gaps_and_nan_split_the_record(rows: int) -> None:
    values, time = white(300), np.arange(300) * 0.5
    values[100:103] = np.nan
    time[200:] += 5.0  # ten samples missing
    phase = read_phase([record(values, time, rows=rows)], "gyro")
    assert [run.size - 1 for run in phase.runs] == [100, 97, 100]
    assert (phase.gaps, phase.missing, phase.bridged) == (2, 13, 0)
    level = np.nanmean(values)
    assert np.diff(phase.runs[1]) == pytest.approx(values[103:200] - level, abs=1e-10)


def test_short_gaps_are_bridged_on_a_line() -> None:
    values, time = white(300), np.arange(300) * 0.5
    values[100:103] = np.nan
    time[200:] += 5.0
    phase = read_phase([record(values, time)], "gyro", bridge=1.5)
    assert [run.size - 1 for run in phase.runs] == [200, 100]
    assert (phase.gaps, phase.missing, phase.bridged) == (1, 13, 3)
    step = (values[103] - values[99]) / 4
    filled = values[99] + step * np.arange(1, 4) - np.nanmean(values)
    assert np.diff(phase.runs[0])[100:103] == pytest.approx(filled, abs=1e-10)


def test_single_bridged_samples_raise_n_squared_by_one_and_a_half_times_their_share() -> None:
    """A filled sample is the mean of its neighbours, which then count 1.5 times in a sum: 2·1.5² instead of 3 in its variance."""
    raised = []
    for seed in range(3):
        values = white(20_000, seed)
        holed = values.copy()
        holed[10 + 20 * np.random.default_rng(50 + seed).choice(999, 400, replace=False)] = np.nan
        whole, bridged = run(record(values, rows=4096)), run(record(holed, rows=4096), bridge=parse_quantity("1 s"))
        raised.append((bridged["N_gyro"].value / whole["N_gyro"].value) ** 2 - 1)
    assert np.mean(raised) == pytest.approx(1.5 * 0.02, abs=0.01)


def test_no_difference_spans_a_gap() -> None:
    """A step at a gap does not show: the sum is over the differences within the two stretches alone."""
    first, second = white(400, 1), white(300, 2) + 1e6
    values = np.concatenate([first, [np.nan], second])
    found = run(record(values)).tables[0].rows
    m = 4
    parts = [np.convolve(part, np.ones(m) / m, "valid") for part in (first, second)]
    steps = np.concatenate([part[m:] - part[:-m] for part in parts])
    row = next(row for row in found if row[0] == pytest.approx(2.0))
    assert row[1] == pytest.approx(math.sqrt(np.mean(steps**2) / 2), rel=1e-7)
    assert row[6] == steps.size


def test_gaps_do_not_move_the_coefficients() -> None:
    values = white(40_000, 3)
    whole = run(record(values, rows=4096))
    holed = values.copy()
    holed[np.random.default_rng(8).choice(40_000, 40, replace=False)] = np.nan
    found = run(record(holed, rows=4096))
    u = found["N_gyro"].standard_uncertainty
    assert found["N_gyro"].value == pytest.approx(whole["N_gyro"].value, abs=2 * u)
    assert u >= 0.99 * whole["N_gyro"].standard_uncertainty
    assert any("other gaps (40) divide the record" in note for note in found.notes)


def test_segments_are_never_joined() -> None:
    phase = read_phase([record(white(50), label="a"), record(white(60) + 9, np.arange(60) * 0.5 + 25, "b")], "gyro")
    assert [run.size - 1 for run in phase.runs] == [50, 60]


def test_short_record() -> None:
    found = run(record(white(60)))
    assert found["N_gyro"].value == pytest.approx(math.sqrt(0.5), rel=0.4)
    assert any("left out" in note for note in found.notes)
    assert [row[0] for row in found.tables[0].rows] == [0.5, 1.0, 2.0, 4.0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (white(1), "no two consecutive usable samples"),
        (np.full(50, np.nan), "no two consecutive usable samples"),
        (np.array([1.0, np.nan, np.nan] * 30), "no two consecutive usable samples|never changes"),
        (np.full(500, 3.0), "never changes"),
        (white(6), "known well enough to be fitted"),
    ],
    ids=["one", "nan", "every other", "constant", "six"],
)
def test_refusals(values: np.ndarray, message: str) -> None:
    with pytest.raises(EstimationError, match=message):
        run(record(values))


def test_other_refusals() -> None:
    other = from_samples(segment("a"), np.arange(9.0), {"other": np.arange(9.0)}, {"other": "V"})
    with pytest.raises(EstimationError, match="no channel 'gyro'"):
        run(other)
    with pytest.raises(EstimationError, match="choose `segments` with one sample rate"):
        run(record(white(300)), record(white(300), np.arange(300) * 0.7, "b", rows=1000))
    with pytest.raises(EstimationError, match="no recorded segments"):
        run()
    with pytest.raises(EstimationError, match="every averaging time in `taus` needs a stretch without gaps"):
        run(record(white(300)), taus=(parse_quantity("1 h"),))


def test_chosen_averaging_times() -> None:
    wanted = tuple(parse_quantity(text) for text in ("0.5 s", "3 s", "10 s", "30 s"))
    rows = run(record(white(2000)), taus=wanted, terms=("N",)).tables[0].rows
    assert [row[0] for row in rows] == pytest.approx([0.5, 3.0, 10.0, 30.0])


def test_a_record_too_long_for_memory_is_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fourth phase point gives the same deviations at multiples of four samples, from a quarter of the differences."""
    values = white(4001)
    monkeypatch.setattr(allan_phase, "LONGEST", 1001)
    thinned = read_phase([record(values)], "gyro")
    assert thinned.decimation == 4
    assert thinned.interval == pytest.approx(2.0)
    assert thinned.lost == 1
    x = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    assert thinned.runs[0] == pytest.approx(x[::4] / 4, abs=1e-9)
    found = run(record(values))
    assert any("one in 4 phase points" in note for note in found.notes)
    assert found["N_gyro"].value == pytest.approx(math.sqrt(0.5), abs=4 * found["N_gyro"].standard_uncertainty)


def test_all_deviations_have_tables_and_a_logarithmic_plot() -> None:
    found = run(record(white(3000)), deviations=("overlapping", "modified", "hadamard"))
    assert [table.title.split()[0] for table in found.tables] == ["Overlapping", "Modified", "Hadamard"]
    assert found.plots[0].log
    for row in found.tables[0].rows:
        value, low, high, freedom = map(figure, row[1:5])
        assert low < value < high
        assert freedom >= 1


def test_design_expects_what_the_record_then_gives() -> None:
    """The predicted uncertainty of N is the scatter of N over simulated records, to within its own error."""
    output = OutputModel("gyro", "pulse/s", noise=NoiseModel(math.sqrt(0.5)))
    model = SensorModel("gyro", (output,), 2.0)
    parameters = AllanDeviationParameters(outputs=("gyro",), terms=("N", "K"))
    planned = segment("rest", dwell=1000.0)
    design = designed(AllanDeviation(), DesignRequest("noise", (planned,), parameters, SITE, model))
    (expected,) = design.predicted
    (unknown,) = design.unpredicted
    assert (unknown.name, unknown.unit) == ("K_gyro", "pulse/s/sqrt(s)")
    assert expected.name == "N_gyro"
    assert expected.value == pytest.approx(math.sqrt(0.5))
    scatter = np.std([run(record(white(2000, k), rows=4000), terms=("N", "K"))["N_gyro"].value for k in range(120)])
    assert 0.6 < scatter / expected.standard_uncertainty < 1.25
    wrong = AllanDeviationParameters(outputs=("other",))
    with pytest.raises(EstimationError, match="no output 'other'"):
        designed(AllanDeviation(), DesignRequest("noise", (planned,), wrong, SITE, model))
    quiet = SensorModel("gyro", (OutputModel("gyro", "pulse/s"),), 2.0)
    silent = designed(AllanDeviation(), DesignRequest("noise", (planned,), parameters, SITE, quiet))
    assert silent.predicted == ()
    assert [one.name for one in silent.unpredicted] == ["N_gyro", "K_gyro"]
