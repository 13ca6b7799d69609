"""`rig init --example`: a shipped configuration comes with what it extends, and nothing is overwritten."""

from pathlib import Path

import pytest

from rig.settings import copy_shipped, load_configuration, shipped, shipped_names
from tests.rig.command_line import rig

ROOT = Path(__file__).parents[3]


def test_every_configuration_of_the_repository_is_shipped_by_its_name() -> None:
    assert shipped_names() == sorted(path.stem for path in (ROOT / "configs").glob("*.toml"))
    assert shipped("demo").read_bytes() == (ROOT / "configs" / "demo.toml").read_bytes()


@pytest.mark.parametrize("name", sorted(set(shipped_names()) - {"rig-example"}))
def test_a_copy_is_the_same_configuration(name: str, tmp_path: Path) -> None:
    written = copy_shipped(name, tmp_path / "mine.toml")
    assert written[0] == tmp_path / "mine.toml"
    assert load_configuration(tmp_path / "mine.toml") == load_configuration(shipped(name))
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in written}


def test_what_is_there_stays(tmp_path: Path) -> None:
    assert rig("init", "--example", "basement", cwd=tmp_path).stdout == "basement.toml\ndemo.toml\n"
    # vault.toml extends both, which lie there as they are
    assert rig("init", "--example", "vault", cwd=tmp_path).stdout == "vault.toml\n"
    (tmp_path / "demo.toml").write_text("# mine")
    done = rig("init", "other.toml", "--example", "basement", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("rig: demo.toml: exists already and is not overwritten")
    assert not (tmp_path / "other.toml").exists()


def test_an_example_that_does_not_exist(tmp_path: Path) -> None:
    done = rig("init", "--example", "cellar", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        f"rig: example cellar: there is no such configuration; there are {', '.join(shipped_names())}\n"
    )
    assert not list(tmp_path.iterdir())
