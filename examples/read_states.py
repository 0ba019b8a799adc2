"""Read what a run recorded, with pandas, polars and DuckDB: `python examples/read_states.py RUN_FOLDER`.

Each reads the whole data set in one line, as a table with a row for each environment step of each body and
`phase` as a column; docs/recording.md says what the columns are. Needs `pip install pandas polars duckdb`.
"""

import sys
from pathlib import Path

import duckdb
import pandas
import polars


def with_pandas(run: Path) -> "pandas.Series[int]":
    """Rows by phase."""
    states = pandas.read_parquet(run / "states")
    return states.groupby("phase", observed=True).size()


def with_polars(run: Path) -> polars.DataFrame:
    """The first step at which each actor was recorded, and the last one."""
    states = polars.read_parquet(run / "states/**/*.parquet", hive_partitioning=True)
    return states.group_by("actor").agg(first=polars.min("step"), last=polars.max("step")).sort("actor")


def with_duckdb(run: Path) -> list[tuple[str, float | None]]:
    """The reward for nearing the goal, of the first block, by phase; None where it acted without a goal."""
    duckdb.sql(f"create or replace view states as select * from '{run}/states/**/*.parquet'")
    reward = next(name for name in duckdb.sql("select * from states").columns if name.startswith("reward/"))
    return duckdb.sql(f'select phase, avg("{reward}") from states group by phase order by phase').fetchall()


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    print(with_pandas(folder))
    print(with_polars(folder))
    print(with_duckdb(folder))
