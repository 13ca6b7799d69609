"""What a connection shows of a blind archive: hidden values are moved, or null, in every table."""

from collections.abc import Iterable, Sequence
from typing import Any

from rig.archive.blind import Seal
from rig.archive.columns import COLUMNS
from rig.archive.enclosing import SEALED_COLUMNS, disclosed_table, withheld
from rig.archive.shelf import SQL_TYPES


def show_as_it_is(connection: Any, names: Iterable[str]) -> None:
    """The tables of an archive that is not blind."""
    for name in names:
        connection.execute(f"create view {name} as select * from open_{name}")


def show_hidden(connection: Any, names: Sequence[str], seal: Seal | None, keys: Sequence[bytes]) -> None:
    """The tables of a blind archive, made once and for all, and no other table or view beside them.

    What is stored sealed is read where its key is among `keys`. Values of columns that `seal` names are moved
    by what belongs to their rig, or null where the key is not here; all other numbers of results but
    uncertainties are null, because they tell what is hidden.
    """
    _disclose(connection, names, keys)
    hosts = [host for (host,) in connection.execute("select distinct host from open_runs").fetchall()]
    scales = {} if seal is None else seal.scales
    columns = "".join(f", {name}_factor double, {name}_offset double" for name in scales)
    connection.execute(f"create table hidden (of_host varchar{columns})")
    if seal is not None and seal.key is not None:
        for host in hosts:
            drawn = [part for name in scales for part in seal.hidden(name, host or "")]
            marks = ", ".join("?" * (1 + len(drawn)))
            connection.execute(f"insert into hidden values ({marks})", [host, *drawn])
    empty = [] if seal is None else withheld(seal)
    shown = {name: f"coalesce(shown.{name}, disclosed.{name})" for name in SEALED_COLUMNS}
    shown |= {name: f"{shown[name]} * hidden.{name}_factor + hidden.{name}_offset" for name in scales}
    shown |= {name: f"null::{SQL_TYPES[COLUMNS[name].kind]}" for name in (*empty, "sealed")}
    replaced = ", ".join(f"{text} as {name}" for name, text in shown.items())
    wanted = {"versions": "versions", "latest": "latest", **{name: f"open_{name}" for name in names}}
    for name, source in wanted.items():
        connection.execute(
            f"create table blind_{name} as select shown.* replace ({replaced}) from {source} as shown "
            "left join hidden on of_host is not distinct from host "
            "left join disclosed on disclosed.sealed = shown.sealed"
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


def _disclose(connection: Any, names: Sequence[str], keys: Sequence[bytes]) -> None:
    """Make the table of what seals hold."""
    sources = ["versions", *(["open_refits"] if "refits" in names else [])]
    question = " union ".join(f"select sealed from {name} where sealed is not null" for name in sources)
    texts = [text for (text,) in connection.execute(question).fetchall()] if keys else []
    connection.register("disclosed_read", disclosed_table(texts, keys))
    connection.execute("create table disclosed as select * from disclosed_read")
    connection.unregister("disclosed_read")
