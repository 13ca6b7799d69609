"""The SQL of the catalogue: the tables and views that a DuckDB connection to an archive has."""

from typing import Final

from rig.archive.columns import COLUMNS, OF_REFITS, SHORT_NAMES
from rig.archive.sessions import OF_FACTS, OF_PLACES
from rig.archive.shelf import SQL_TYPES

_NAMES = ", ".join(COLUMNS)
NO_ROWS: Final = f"""
create table no_rows (
  {", ".join(f"{name} {SQL_TYPES[column.kind]}" for name, column in COLUMNS.items())},
  {", ".join(f"{name} {kind}" for name, kind in OF_FACTS.items())}, now boolean, listed boolean
)
"""
REMARKS: Final = """
create table remarks as
  select
    unnest($1::varchar[]) as run_sha256, unnest($2::varchar[][]) as tags, unnest($3::varchar[][]) as notes
"""
ALL_MERGED: Final = """
create view all_rows as
  select * from no_rows union all by name select * from read_parquet(getvariable('merged'))
"""
"""Where one merged file holds what all facts say."""

_OF_PLACES = ", ".join(OF_PLACES)
SOME_MERGED: Final = "select * exclude (now, listed) from read_parquet(getvariable('merged'))"
NONE_MERGED: Final = "select * exclude (now, listed) from no_rows"
NOT_ALL_MERGED: Final = f"""
create table every_row as
  with
    before as (MERGED),
    seen as (
      select states.* exclude ({_OF_PLACES}), facts.*
      from (select * from no_rows_of_states union all by name select * from loose_rows) as states
      join loose_facts as facts on facts.version = states.version
    )
  select * exclude (now, listed) from no_rows
  union all by name
  select * from before anti join loose_facts using (computer, folder, version)
  union all by name
  select * from seen;
create view all_rows as
  with
    marked as (
      select *, (turn, writer, place) = max((turn, writer, place)) over (partition by computer, folder) as now
      from every_row
    )
  select
    *,
    now and 1 = row_number() over (
      partition by sha256, now order by turn desc, writer desc, place desc, run
    ) as listed
  from marked
"""
"""Where facts came after the merged file: what they say instead, and what then is the last of each folder."""

STATES: Final = f"create view no_rows_of_states as select {_NAMES} from no_rows"
VIEWS: Final = f"""
create view versions as select * exclude (now, listed) from all_rows;
create view latest as select * exclude (now, listed) from all_rows where now;
create view open_runs as
  select
    {", ".join(f"shown.{name}" for name in COLUMNS)},
    coalesce(tags, []::varchar[]) as tags, coalesce(notes, []::varchar[]) as notes,
    {", ".join(f"{name} as {short}" for short, name in SHORT_NAMES.items())}
  from (select * from all_rows where listed) as shown left join remarks on run_sha256 = sha256;
"""
"""`versions`: every state that was seen; `latest`: the present one of each folder; the runs, each once."""

FROM_RESULTS: Final = [*list(COLUMNS)[list(COLUMNS).index("configuration_sha256") :], "version"]
"""Columns that results decide; the others are the run's."""
REFIT_COLUMNS: Final = {
    **{name: COLUMNS[name] for name in ("sha256", *FROM_RESULTS)},
    **{name: column for name, column in OF_REFITS.items() if name != "newest"},
}
REFITS: Final = f"""
create view made as SOURCE;
create view open_refits as
  select
    runs.* replace ({", ".join(f"made.{name} as {name}" for name in FROM_RESULTS)}),
    level, laws, settings, code, made_utc,
    row_number() over (
      partition by made.sha256 order by coalesce(made.turn, 0) desc, made_utc desc, made.version desc
    ) = 1 as newest
  from made join open_runs as runs on runs.sha256 = made.sha256
  where list_contains(getvariable('refits_there'), made.version)
"""
"""The newest is the one with the largest turn; only those of earlier versions, without, go by the clock."""
