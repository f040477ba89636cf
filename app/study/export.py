"""A study's runs as a table for other programs: CSV or Parquet, a row for each run."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from sidelong.app.errors import missing_package
from sidelong.app.study.store import MEASURES, run_ids
from sidelong.app.study.study import Study

SUFFIXES = (".csv", ".parquet")
_ROWS = 5000  # of Parquet at a time

_COLUMNS = ("planner", "run", "target", "draw", "seed", *MEASURES, "key")


def write_runs(study: Study, file: Path) -> int:
    """Write every run that is known and return how many. Columns: swept parameters, then the same for every study.

    Raises OSError; InputError when Parquet is asked for and pyarrow is not installed.
    """
    columns = (*(key for key, _ in study.designs[0].swept), *_COLUMNS)
    write = _write_parquet if file.suffix.lower() == ".parquet" else _write_csv
    return write(file, columns, _rows(study))


def _rows(study: Study) -> Iterator[tuple[Any, ...]]:
    for design in study.designs:
        swept = tuple(value for _, value in design.swept)
        for planner in design.settings.planners:
            for run, result in study.store.results(run_ids(design.settings, planner)):
                measures = (getattr(result, name) for name in MEASURES)
                known = (None if math.isnan(value) else value for value in measures)
                whose = (str(planner), run.number, run.target, run.draw, design.settings.seed)
                yield (*swept, *whose, *known, run.key)


def _write_csv(file: Path, columns: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> int:
    with file.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(columns)
        return sum(1 for row in rows if writer.writerow(row))


def _write_parquet(file: Path, columns: tuple[str, ...], rows: Iterator[tuple[Any, ...]]) -> int:
    arrow, parquet = parquet_writer()
    count, writer = 0, None
    try:
        while part := list(itertools.islice(rows, _ROWS)):
            table = arrow.table(
                {name: arrow.array(values) for name, values in zip(columns, zip(*part, strict=True), strict=True)}
            )
            if writer is None:
                writer = parquet.ParquetWriter(file, _typed(arrow, table.schema))
            writer.write_table(table.cast(writer.schema))
            count += len(part)
    finally:
        if writer is not None:
            writer.close()
    return count


def _typed(arrow: Any, schema: Any) -> Any:
    """Return the schema in which a measure that nothing was known of at first is a number."""
    return arrow.schema([(f.name, arrow.float64() if f.name in MEASURES else f.type) for f in schema])


def parquet_writer() -> tuple[Any, Any]:
    """Return pyarrow and its Parquet module. Raises InputError when it is not installed."""
    try:
        import pyarrow  # noqa: PLC0415  # an extra
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError as error:
        raise missing_package("--export: Parquet", "pyarrow", "write a .csv") from error
    return pyarrow, pyarrow.parquet
