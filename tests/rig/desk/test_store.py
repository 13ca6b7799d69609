"""What outlives a desk; and a folder of sessions has one desk."""

from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from processing.errors import ConfigurationError
from rig.desk.store import DeskStore
from tests.disk_without_locks import without_locks

ADDRESS = "http://127.0.0.1:8642/?key={}"


def opened(output: Path) -> DeskStore:
    """The store of a desk that is open."""
    store = DeskStore()
    store.hold(output)
    store.opened_at(ADDRESS.format(store.key))
    return store


@pytest.mark.parametrize("has_locks", [True, False])
def test_key_and_port_outlive_a_desk_and_are_those_of_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_locks: bool
) -> None:
    if not has_locks:
        without_locks(monkeypatch)
    first = opened(tmp_path)
    assert first.port == 0
    first.close()
    again, other = DeskStore(), opened(tmp_path / "elsewhere")
    again.hold(tmp_path)
    assert (again.key, again.port) == (first.key, 8642)
    assert other.key != first.key
    again.close()
    other.close()


def test_of_the_sessions_in_a_folder_there_is_one_desk(tmp_path: Path) -> None:
    """They would be ordered about by two."""
    kept = opened(tmp_path)
    with pytest.raises(ConfigurationError) as refused:
        DeskStore().hold(tmp_path)
    assert f"it already has an open desk: use {ADDRESS.format(kept.key)}" in str(refused.value)
    kept.close()
    # the refused one has left nothing behind
    kept.hold(tmp_path)
    kept.close()
