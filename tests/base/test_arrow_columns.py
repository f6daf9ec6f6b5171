"""Columns between numpy and pyarrow: the same numbers either way, and pandas stays away."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pyarrow as pa

from planrunner.base.arrow_columns import column, numbers


def test_numbers_come_back_as_they_went() -> None:
    values = np.array([1.0, -0.0, math.inf, 5e-324, math.nan])
    assert column(values).type == pa.float64()
    assert numbers(column(values)).tobytes() == values.tobytes()
    assert numbers(column(values[::2])).tobytes() == values[::2].tobytes()
    assert numbers(column(values).slice(1, 2)).tolist() == [0.0, math.inf]
    assert numbers(column(np.array([]))).tolist() == []
    assert column(np.array([1, 2], dtype=np.int16)).to_pylist() == [1.0, 2.0]


def test_a_missing_number_is_nan() -> None:
    found = numbers(pa.array([None, 1.0, None, 3.0]).slice(1))
    assert np.array_equal(found, [1.0, math.nan, 3.0], equal_nan=True)


def test_what_was_read_outlives_its_column() -> None:
    found = numbers(column(np.arange(1e5)))
    again = [column(np.full(100_000, -1.0)) for _ in range(5)]
    assert found[-1] == 99_999 and len(again) == 5


def test_pandas_is_not_imported() -> None:
    code = (
        "import sys, numpy as np, pyarrow as pa; from planrunner.base.arrow_columns import column, numbers;"
        "table = pa.Table.from_arrays([column(np.arange(3.0))], ['a']);"
        "numbers(table.column('a').chunk(0)); sys.exit('pandas' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
