"""Bad recordings through `planrunner diagnose`: a clear answer or error each, never a traceback or a library's warning."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from jsonschema import Draft202012Validator

from planrunner.cli import main
from planrunner.cli.exit_codes import DONE, WRONG_INPUT
from tests.tasks.test_diagnose import SCHEMA, change, laboratory, listed, set_at

Ended = tuple[int, str, str]
DRAW = np.random.default_rng(1)
ALONE = {"gyro_x_deg_per_s": "gyro_y_deg_per_s", "gyro_y_deg_per_s": "gyro_x_deg_per_s"}


@pytest.fixture
def diagnosed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Exit code, standard output and standard error of a diagnosis of so many segments, with columns changed."""

    def run(count: int = 12, **columns: Callable[[np.ndarray], np.ndarray]) -> Ended:
        laboratory(tmp_path, listed()[:count])
        change(tmp_path, **columns)
        code = main(["diagnose", str(tmp_path / "plan.yaml"), "--recording", str(tmp_path / "recording.parquet")])
        printed = capsys.readouterr()
        assert "internal error" not in printed.err and "Warning:" not in printed.err
        return code, printed.out, printed.err

    return run


@pytest.mark.parametrize("count", [4, *(pytest.param(count, marks=pytest.mark.slow) for count in (5, 6))])
def test_few_segments_are_answered(diagnosed: Callable[..., Ended], count: int) -> None:
    code, out, _ = diagnosed(count)
    assert code == DONE and "No effect is named" in out


@pytest.mark.parametrize("count", [2, 3])
def test_too_few_segments_are_refused(diagnosed: Callable[..., Ended], count: int) -> None:
    code, _, err = diagnosed(count)
    assert code == WRONG_INPUT and f"the recording has {count} segments" in err


@pytest.mark.parametrize("value", [np.nan, *(pytest.param(value, marks=pytest.mark.slow) for value in (np.inf, 1e300))])
def test_what_is_no_number_is_left_out_and_reported(diagnosed: Callable[..., Ended], value: float) -> None:
    code, out, err = diagnosed(gyro_x_deg_per_s=set_at(10, 12, value))
    assert code == DONE and "No effect is named" in out
    assert "warning[gap-missing-numbers]: 2 rows with a missing number were left out" in err


MISFITS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "deaf": (lambda v: DRAW.normal(0, 0.01, len(v)), "of the applied angular rate"),
    "no unit": (lambda v: 0.123 * v, "it shows 0.123 of x"),
}


@pytest.mark.parametrize("name", MISFITS)
def test_a_channel_that_does_not_follow_the_plan_is_refused(diagnosed: Callable[..., Ended], name: str) -> None:
    """Nominal parameters could take it whole: no misfit is left, and no sensor is like that."""
    act, words = MISFITS[name]
    code, _, err = diagnosed(gyro_x_deg_per_s=act)
    assert code == WRONG_INPUT
    assert "error[gap-nominal-misfit]: 'gyro_x' does not follow the plan" in err and words in err


DECLARED: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str, str]] = {
    "wrong sign": (lambda v: -v, "sign of a channel is reversed: 'gyro_x' has the opposite sign", "Change the `sign`"),
    "wrong unit": (np.radians, "unit of a channel is wrong: 'gyro_x': 0.01745 times the input", "between radians"),
}


@pytest.mark.parametrize("name", DECLARED)
def test_a_wrong_declaration_is_named_and_corrected(diagnosed: Callable[..., Ended], name: str) -> None:
    act, words, more = DECLARED[name]
    code, out, err = diagnosed(gyro_x_deg_per_s=act)
    assert code == DONE and "No effect is named" in out
    assert f"warning[gap-declaration]: {words}" in err and more in err


def test_exchanged_columns_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    laboratory(tmp_path, listed()[:12])
    table = pq.read_table(tmp_path / "recording.parquet")
    pq.write_table(
        pa.table({ALONE.get(name, name): table[name] for name in table.column_names}), tmp_path / "recording.parquet"
    )
    given = [str(tmp_path / "plan.yaml"), "--recording", str(tmp_path / "recording.parquet")]
    assert main(["diagnose", *given, "--json"]) == DONE
    printed = capsys.readouterr()
    assert "'gyro_x' and 'gyro_y' are exchanged" in printed.err
    found = json.loads(printed.out)
    (one,) = found["declarations"]
    assert (one["effect"], one["actor"], one["parameters"]) == ("axes_exchanged", "bookkeeping", {"gyro_xy": 1.0})
    assert "Exchange the columns of these channels in the bench file: 'gyro_x' and 'gyro_y'." in one["remedy"]
    Draft202012Validator(SCHEMA).validate(found)


def test_noise_far_from_what_is_declared_is_reported(diagnosed: Callable[..., Ended]) -> None:
    code, _, err = diagnosed(6, gyro_x_deg_per_s=lambda v: v + DRAW.normal(0, 0.2, len(v)))
    assert code == DONE
    assert "warning[gap-noise]: 'gyro_x' has a noise at rest of 0.2" in err and "the declared noise is 0.01" in err
