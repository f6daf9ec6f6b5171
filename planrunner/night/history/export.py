"""Exports an index to Parquet files or a DuckDB database, for analyses with other tools."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.findings import InputError, Mark
from planrunner.night.history.index import Index
from planrunner.night.history.rows import CoefficientRow, LimitRow

if TYPE_CHECKING:
    import pyarrow as pa


def export_index(index: Index, target: Path) -> None:
    """Writes the tables runs, coefficients and limits. If the name of the target ends with `.duckdb`, the tables are written to a
    DuckDB database. Otherwise, they are written as Parquet files to a folder, which is created if it does not exist. An existing
    database or file of these names is replaced as a whole. Raises `InputError` if the files cannot be written."""
    tables = index_tables(index)
    try:
        if target.suffix == ".duckdb":
            _write_duckdb(tables, target)
        else:
            _write_parquet(tables, target)
    except OSError as error:
        message = f"the export cannot be written: {error.strerror or error}"
        raise InputError.at(
            Mark(str(target)), "file-unwritable", message, "free disk space, or choose another place"
        ) from None


def index_tables(index: Index) -> dict[str, pa.Table]:
    """Returns the index as Arrow tables. The column `folder` joins the tables; times have the type timestamp in UTC."""
    import pyarrow as pa

    runs = index.runs()
    stamp = pa.timestamp("us", tz="UTC")
    texts = (
        "folder",
        "run",
        "plan",
        "title",
        "device",
        "bench",
        "laboratory",
        "operator",
        "origin",
        "state",
        "verdict",
    )
    columns = {name: pa.array([getattr(run, name) for run in runs], pa.string()) for name in texts}
    columns["created"] = pa.array([run.created for run in runs], pa.string()).cast(stamp)
    columns |= {name: pa.array([getattr(run, name) for run in runs], pa.int64()) for name in ("analysis", "warnings")}
    tables = {"runs": pa.table(columns)}
    tables["coefficients"] = _table(CoefficientRow, index.all_coefficients())
    tables["limits"] = _table(LimitRow, index.all_limits())
    return tables


def _table(kind: type[CoefficientRow | LimitRow], rows: Sequence[tuple[str, CoefficientRow | LimitRow]]) -> pa.Table:
    import pyarrow as pa

    found = {"folder": pa.array([folder for folder, _ in rows], pa.string())}
    for item in fields(kind):
        number = item.type == "float"
        values = [getattr(row, item.name) for _, row in rows]
        found[item.name] = pa.array(
            values if number else list(map(str, values)), pa.float64() if number else pa.string()
        )
    return pa.table(found)


def _write_parquet(tables: dict[str, pa.Table], target: Path) -> None:
    import pyarrow.parquet as pq

    target.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        aside = target / f".{name}.{os.getpid()}.partial"
        try:
            pq.write_table(table, aside)
            aside.replace(target / f"{name}.parquet")
        finally:
            aside.unlink(missing_ok=True)


def _write_duckdb(tables: dict[str, pa.Table], target: Path) -> None:
    try:
        import duckdb
    except ImportError:
        hint = "install planrunner with the extra: pip install 'planrunner[duckdb]'; or export to a folder of Parquet files"
        raise InputError.at(Mark(str(target)), "index-kind", "DuckDB is not installed", hint) from None
    aside = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        with duckdb.connect(str(aside)) as connection:
            for name, table in tables.items():
                connection.register(f"given_{name}", table)
                connection.execute(f"CREATE TABLE {name} AS SELECT * FROM given_{name}")
        aside.replace(target)
    except duckdb.Error as error:
        raise OSError(0, str(error)) from None
    finally:
        aside.unlink(missing_ok=True)
