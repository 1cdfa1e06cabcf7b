"""All rows of an experiment with all their columns, for other programs: CSV and Parquet."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

from clrelight.errors import InputError
from clrelight.report.rows import text
from clrelight.results import Results


def check_parquet() -> None:
    """Raise InputError if Parquet cannot be written here."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise InputError("Parquet needs pyarrow: pip install 'clrelight[parquet]', or take rows.csv") from error


def columns_of(results: Results) -> dict[str, list[Any]]:
    """Return the columns of the table, texts as str."""
    table = results.table
    return {
        name: [text(value) if isinstance(value, bytes) else value for value in table[name].tolist()]
        for name in table.dtype.names or ()
    }


def rows_csv(results: Results) -> str:
    """Return every row as comma-separated values with every digit; ``inf`` as such, NaN as an empty field."""
    columns, stream = columns_of(results), io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow("" if isinstance(value, float) and math.isnan(value) else value for value in row)
    return stream.getvalue()


def write_parquet(results: Results, path: Path) -> None:
    """Write every row as Parquet: texts, integers and doubles, what was not measured as null."""
    import pyarrow
    import pyarrow.parquet

    types = {"S": pyarrow.string(), "i": pyarrow.int64(), "f": pyarrow.float64()}
    arrays = {
        name: pyarrow.array(values, types[results.table.dtype[name].kind], from_pandas=True)
        for name, values in columns_of(results).items()
    }
    pyarrow.parquet.write_table(pyarrow.table(arrays), path)
