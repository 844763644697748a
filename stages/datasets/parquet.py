"""Reads Parquet files of other libraries, a few rows at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import ArtifactError, PlatformError
from stages.datasets.episode import brief, check_is_there, reason_of

AT_A_TIME = 32  # maximum number of rows with images in memory
PATHS_AT_A_TIME = 1024
MEMORY = 64 * 2**20  # bytes of images to read at a time
MOST_PACKED = 100  # maximum compression ratio of a column of images, which are compressed already
FEW_ROWS = 2**20  # of a table; more are refused if they outnumber the bytes
BUFFER = 2**20  # bytes read at a time
IMAGE = ("bytes", "path")  # fields of an image
REFUSALS = (OSError, ValueError, TypeError, KeyError, OverflowError, MemoryError)  # of pyarrow, for damaged files


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
        ArtifactError: The file is missing or damaged, even if that is detected only while the block runs, or declares
            far more rows than its size allows.
    """
    pyarrow = arrow()
    check_is_there(path)
    try:
        with pyarrow.parquet.ParquetFile(path, buffer_size=BUFFER) as file:
            rows = file.metadata.num_rows
            if rows > max(FEW_ROWS, path.stat().st_size):  # Each row has an index of its own, which takes space.
                raise ArtifactError(f"{path}: declares {rows} rows, more than it has bytes: do not trust this file")
            yield file
    except (pyarrow.ArrowException, *REFUSALS) as error:
        raise ArtifactError(
            f"{path}: is not a complete Parquet file ({reason_of(error)}): download it again"
        ) from error


def names_in(path: Path) -> list[str]:
    """Names of the columns of a table. Raises ArtifactError if the file is missing or damaged."""
    with opened(path) as file:
        return list(file.schema_arrow.names)


def columns(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Read whole numeric columns as floats, (rows,) each. Nulls become NaN.

    Raises:
        ArtifactError: The file is missing or damaged, lacks one of `names`, or a column is not numeric.
    """
    types = arrow().types
    with opened(path) as file:
        schema = file.schema_arrow
        if missing := [name for name in names if name not in schema.names]:
            raise ArtifactError(f"{path}: has no column {missing[0]}: expected a table of a LeRobot v3 dataset")
        wanted = [*names, *(name for name in optional if name in schema.names)]
        for name in wanted:
            kind = schema.field(name).type
            if not (types.is_integer(kind) or types.is_floating(kind) or types.is_null(kind)):
                raise ArtifactError(f"{path}: its column {name} holds {brief(kind)}: expected numbers")
        table = file.read(wanted)
        return {name: np.array(table.column(name).cast("float64", safe=False)) for name in wanted}


def rows(path: Path, column: str, wanted: np.ndarray) -> Iterator[Any]:
    """Yield the values of a column of images at non-decreasing row numbers. A repeated number yields its value again.

    An image is bytes, a path, or a dictionary with one of them. At most a few images are in memory at a time.

    Raises:
        ArtifactError: The file is damaged, has fewer rows, or the column does not hold images.
    """
    with opened(path) as file:
        parts = _parts_of_images(file, path, column)
        begin, sought = 0, list(map(int, wanted))
        for group in range(file.num_row_groups):
            end = begin + file.metadata.row_group(group).num_rows
            if not sought:
                return
            if sought[0] >= end:
                begin = end
                continue
            for batch in file.iter_batches(_batch(file, path, column, group), row_groups=[group], columns=parts):
                values = batch.column(0)
                while sought and sought[0] < begin + len(values):
                    yield values[sought.pop(0) - begin].as_py()
                begin += len(values)
                if not sought:
                    return
            begin = end
        if sought:
            raise ArtifactError(f"{path}: ends at row {begin}, before row {sought[0]}: download it again")


def paths(path: Path, column: str) -> list[str | None]:
    """The paths in a column of images, row by row; None where there is none. Empty if all images are in the table.

    Raises:
        ArtifactError: The file is damaged, or the column does not hold images.
    """
    with opened(path) as file:
        parts = _parts_of_images(file, path, column)
        if _all_there(file, f"{column}.bytes" if len(parts) > 1 else ""):
            return []
        found: list[str | None] = []
        for batch in file.iter_batches(PATHS_AT_A_TIME, columns=parts[-1:]):
            for value in batch.column(0).to_pylist():
                name = value.get("path") if isinstance(value, dict) else value
                found.append(name if isinstance(name, str) else None)
        return found


def _all_there(file: Any, part: str) -> bool:
    """Whether the statistics of a column say that no value is missing."""
    metadata = file.metadata
    groups = [metadata.row_group(k) for k in range(file.num_row_groups)]
    chunks = [group.column(k) for group in groups for k in range(group.num_columns)]
    statistics = [chunk.statistics for chunk in chunks if chunk.path_in_schema == part]
    return bool(statistics) and all(each is not None and each.null_count == 0 for each in statistics)


def _parts_of_images(file: Any, path: Path, column: str) -> list[str]:
    """Names of the columns that hold the images: the column itself, or its fields `bytes` and `path`."""
    types, schema = arrow().types, file.schema_arrow
    if column not in schema.names:
        raise ArtifactError(f"{path}: has no column {brief(column)}: download the dataset again")
    kind = schema.field(column).type
    fields = [
        (f"{column}.{name}", kind.field(name).type) for name in IMAGE if types.is_struct(kind) and name in kind.names
    ]
    parts = fields or [(column, kind)]
    tests = types.is_binary, types.is_large_binary, types.is_string, types.is_large_string, types.is_null
    if not all(any(test(part) for test in tests) for _, part in parts):
        raise ArtifactError(f"{path}: its column {brief(column)} holds {brief(kind)}: expected images")
    return [name for name, _ in parts]


def _batch(file: Any, path: Path, column: str, group: int) -> int:
    """Rows to read at a time, so that even equal images, which are stored once, do not fill the memory."""
    metadata = file.metadata.row_group(group)
    size = packed = 0
    for k in range(metadata.num_columns):
        chunk = metadata.column(k)
        if chunk.path_in_schema == column or chunk.path_in_schema.startswith(f"{column}."):
            size, packed = size + chunk.total_uncompressed_size, packed + chunk.total_compressed_size
    if size > max(MEMORY, MOST_PACKED * packed):
        raise ArtifactError(f"{path}: expands to {size} bytes of {brief(column)}: do not trust this file")
    return min(max(MEMORY // max(size, 1), 1), AT_A_TIME)
