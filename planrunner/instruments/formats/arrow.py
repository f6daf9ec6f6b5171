"""Reads rows of an Arrow batch as numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planrunner.base import arrow_columns
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.formats import clock
from planrunner.instruments.interfaces import InstrumentError

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, slots=True)
class ArrowRows:
    """Contains the rows of an Arrow batch from the file `name`. `first`: number of the first row, counted from 1."""

    batch: pa.RecordBatch
    first: int
    name: str

    @property
    def count(self) -> int:
        return int(self.batch.num_rows)

    def numbers(self, column: str) -> Array:
        import pyarrow as pa

        values = self.batch.column(column)
        try:
            # counts of nanoseconds have more digits than float64, which rounds them to about 0.3 µs
            values = values.cast(pa.float64(), safe=not pa.types.is_integer(values.type))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            rows = f"rows {self.first} to {self.first + self.count - 1}"
            message = f"column '{column}' contains a value that is not a number, in {rows}"
            raise InstrumentError(f"{self.name}: {message}") from None
        return arrow_columns.numbers(values)

    def words(self, column: str) -> tuple[list[str], NDArray[np.int64]]:
        import pyarrow as pa

        encoded = self.batch.column(column).cast(pa.string()).dictionary_encode()
        return encoded.dictionary.to_pylist(), np.asarray(encoded.indices.fill_null(-1), np.int64)

    def times(self, column: str, where: clock.PlaceOfText, dates: clock.DateOrder) -> Array:
        return clock.of_arrow(self.batch.column(column), where, dates)
