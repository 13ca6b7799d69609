"""What a connection shows of a blind archive: hidden values are moved, or null, in every table."""

from collections.abc import Iterable
from typing import Any, Final

from rig.archive.blind import Seal
from rig.archive.catalogue import FROM_RESULTS
from rig.archive.columns import COLUMNS

_KEPT: Final = ("chi2_per_dof", "mass_kg", "ball_radius_m")
"""Numbers of results that tell nothing of a parameter."""
_COUNTS: Final = ("half_cycles", "frames")
"""They tell the period, beside the duration."""


def show_as_it_is(connection: Any, names: Iterable[str]) -> None:
    """The tables of an archive that is not blind."""
    for name in names:
        connection.execute(f"create view {name} as select * from open_{name}")


def show_hidden(connection: Any, names: Iterable[str], seal: Seal) -> None:
    """The tables of a blind archive, made once and for all, and no other table or view beside them.

    Values of sealed columns are moved by what belongs to their rig, or null where the key is not here; all
    other numbers of results but uncertainties are null, because they tell what is hidden.
    """
    hosts = [host for (host,) in connection.execute("select distinct host from open_runs").fetchall()]
    columns = ", ".join(f"{name}_factor double, {name}_offset double" for name in seal.scales)
    connection.execute(f"create table hidden (of_host varchar, {columns})")
    if seal.key is not None:
        for host in hosts:
            drawn = [part for name in seal.scales for part in seal.hidden(name, host or "")]
            marks = ", ".join("?" * (1 + len(drawn)))
            connection.execute(f"insert into hidden values ({marks})", [host, *drawn])
    moved = [f"{name} * hidden.{name}_factor + hidden.{name}_offset as {name}" for name in seal.scales] + [
        f"null::{kind} as {name}" for name, kind in _withheld(seal)
    ]
    wanted = {"versions": "versions", "latest": "latest", **{name: f"open_{name}" for name in names}}
    for name, source in wanted.items():
        connection.execute(
            f"create table blind_{name} as select shown.* replace ({', '.join(moved)}) "
            f"from {source} as shown left join hidden on of_host is not distinct from host"
        )
    kept = {f"blind_{name}" for name in wanted}
    found = connection.execute(
        "select table_name, table_type from information_schema.tables where table_schema = 'main'"
    ).fetchall()
    for name, kind in found:
        if name not in kept:
            connection.execute(f"drop {'view' if kind == 'VIEW' else 'table'} {name}")
    for name in wanted:
        connection.execute(f"alter table blind_{name} rename to {name}")


def _withheld(seal: Seal) -> list[tuple[str, str]]:
    numbers = [
        (name, "double")
        for name in ("initial_amplitude", "final_amplitude", *FROM_RESULTS)
        if COLUMNS[name].kind == "number"
        and name not in seal.scales
        and name not in _KEPT
        and not name.startswith("u_")
    ]
    told = [(name, "bigint") for name in _COUNTS if "period0_s" in seal.scales]
    return [*dict.fromkeys(numbers), *told]
