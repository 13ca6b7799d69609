"""What outlives a desk; and there is one desk of a configuration."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from processing.errors import ConfigurationError
from rig.desk.store import DeskStore
from tests.disk_without_locks import without_locks


def test_key_and_port_outlive_a_desk(tmp_path: Path) -> None:
    source = tmp_path / "rig.toml"
    first = DeskStore(source)
    first.hold(tmp_path)
    first.opened_at("http://127.0.0.1:8642/", 8642)
    first.close()
    second = DeskStore(source)
    second.hold(tmp_path)
    assert (second.key, second.port) == (first.key, 8642)
    second.close()
    other = DeskStore(tmp_path / "other.toml")
    other.hold(tmp_path)
    assert other.key != first.key
    other.close()


@pytest.mark.slow
def test_of_the_sessions_in_a_folder_there_is_one_desk(tmp_path: Path) -> None:
    """They would be ordered about by two; in a process, too, and whatever the other's configuration."""
    source = tmp_path / "rig.toml"
    kept = DeskStore(source)
    kept.hold(tmp_path)
    kept.opened_at("http://127.0.0.1:1/?key=k", 1)
    with pytest.raises(ConfigurationError, match=r"already has an open desk: use http://127.0.0.1:1/\?key=k"):
        DeskStore(tmp_path / "other.toml").hold(tmp_path)
    other = (
        "import sys; from pathlib import Path; from rig.desk.store import DeskStore; "
        "source = Path(sys.argv[1]); DeskStore(source).hold(source.parent)"
    )
    done = subprocess.run(
        [sys.executable, "-c", other, str(source)], capture_output=True, text=True, check=False, timeout=50
    )
    assert "it already has an open desk: use http://127.0.0.1:1/?key=k" in done.stderr
    # that of other sessions may be open beside it
    (tmp_path / "elsewhere").mkdir()
    beside = DeskStore(source)
    beside.hold(tmp_path / "elsewhere")
    assert beside.key == kept.key
    beside.close()
    kept.close()
    # the refused one has left nothing behind
    kept.hold(tmp_path)
    kept.close()


def test_a_disk_without_locks_is_not_called_another_desk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_locks(monkeypatch)
    kept = DeskStore(tmp_path / "rig.toml")
    kept.hold(tmp_path)
    kept.opened_at("http://127.0.0.1:8642/", 8642)
    kept.close()
    again = DeskStore(tmp_path / "rig.toml")
    again.hold(tmp_path)
    assert again.port == 8642
    again.close()
