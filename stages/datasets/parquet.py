"""Reads Parquet files of other libraries, a few rows at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError, PlatformError
from stages.datasets.episode import check_is_there

AT_A_TIME = 32  # rows with images in memory
BUFFER = 2**20  # bytes read at a time


def arrow() -> Any:
    """Import and return pyarrow, including `pyarrow.parquet`.

    Raises:
        PlatformError: pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise PlatformError("LeRobot datasets need pyarrow: pip install 'ifo[lerobot]'") from error
    return pyarrow


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a `pyarrow.parquet.ParquetFile`.

    Raises:
        ArtifactError: The file is missing or damaged, even if that is detected only while the block runs.
    """
    pyarrow = arrow()
    check_is_there(path)
    try:
        with pyarrow.parquet.ParquetFile(path, buffer_size=BUFFER) as file:
            yield file
    except (pyarrow.ArrowException, OSError, UnicodeError) as error:
        reason = " ".join(str(error).split())
        raise ArtifactError(f"{path}: is not a complete Parquet file ({reason}): download it again") from error


def columns(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, list[Any]]:
    """Read whole numeric columns. A null becomes None.

    Raises:
        ArtifactError: The file is missing or damaged, lacks one of `names`, or a column is not numeric.
    """
    types = arrow().types
    with opened(path) as file:
        there = set(file.schema_arrow.names)
        if missing := [name for name in names if name not in there]:
            raise ArtifactError(f"{path}: has no column {missing[0]}: expected a table of a LeRobot v3 dataset")
        table = file.read([*names, *(name for name in optional if name in there)])
        for name, kind in zip(table.column_names, table.schema.types, strict=True):
            if not (types.is_integer(kind) or types.is_floating(kind) or types.is_null(kind)):
                raise ArtifactError(f"{path}: its column {name} holds {kind}: expected numbers")
        return {name: table.column(name).to_pylist() for name in table.column_names}


def rows(path: Path, column: str, wanted: np.ndarray) -> Iterator[Any]:
    """Yield the values of a column at non-decreasing row numbers. A repeated number yields its value again.

    Raises:
        ArtifactError: The file is damaged or has fewer rows.
    """
    with opened(path) as file:
        if column not in file.schema_arrow.names:
            raise ArtifactError(f"{path}: has no column {column}: download the dataset again")
        begin, sought = 0, list(map(int, wanted))
        for group in range(file.num_row_groups):
            end = begin + file.metadata.row_group(group).num_rows
            if not sought:
                return
            if sought[0] >= end:
                begin = end
                continue
            for batch in file.iter_batches(AT_A_TIME, row_groups=[group], columns=[column]):
                values = batch.column(0)
                while sought and sought[0] < begin + len(values):
                    yield values[sought.pop(0) - begin].as_py()
                begin += len(values)
                if not sought:
                    return
            begin = end
        if sought:
            raise ArtifactError(f"{path}: ends at row {begin}, before row {sought[0]}: download it again")
