"""What commands would write over, or cannot write, is refused before the work."""

import shutil
from pathlib import Path

import pytest
import typer

from rig.cli import app
from tests.rig.command_line import CONFIGS, SAMPLES, rig
from tests.rig.commands.wrong_inputs import commands

DEMO = str(CONFIGS / "demo.toml")
NEW_FILES = {
    ("archive", "list"): ("out.csv", "-o"),
    ("camera", "snap", DEMO): ("out.png", "-o"),
    ("view", "no.mcap"): ("out.rrd", "--rrd"),
    ("run", DEMO, "--record-only"): ("out.mcap", "-o"),
    ("record", "recover", "no.mcap"): ("out.mcap", "-o"),
    ("report", "no"): ("out.html", "-o"),
    ("export", "no", "--format", "hdf5"): ("out.h5", "-o"),
    ("balance", DEMO): ("out.rrd", "--rrd"),
}
FOLDERS = {
    ("run", DEMO): "run-1.mcap",
    ("replay", "no.mcap"): "results.json",
    ("fit", "no.mcap"): "results.json",
    ("compare", "no", "nor"): "campaign.json",
    ("calibrate", "clock", "no.mcap"): "",
    ("export", "no"): "",
}


def empty_inputs(words: tuple[str, ...], folder: Path) -> list[str]:
    """Make the records, plans and results that a call names, empty: there, and not to be read."""
    names = [word for word in words if word.startswith("no")]
    for name in names:
        path = folder / name if "." in name else folder / name / "results.json"
        path.parent.mkdir(exist_ok=True)
        path.touch()
    return names


@pytest.mark.parametrize("words", NEW_FILES)
def test_a_file_that_exists_is_refused_before_anything_is_read(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    name, option = NEW_FILES[words]
    (tmp_path / name).write_text("kept")
    inputs = empty_inputs(words, tmp_path)
    done = rig(*words, option, name, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == f"rig: {name}: exists already and is not overwritten; choose another name\n"
    assert (tmp_path / name).read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {name, *inputs}


@pytest.mark.parametrize("words", FOLDERS)
def test_a_folder_that_is_a_file_or_holds_results_is_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    empty_inputs(words, tmp_path)
    for place in ("file", "file/deeper"):
        done = rig(*words, "-o", place, cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith(f"rig: {place}: ")
    if FOLDERS[words]:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / FOLDERS[words]).write_text("kept")
        done = rig(*words, "-o", "out", cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith(f"rig: out/{FOLDERS[words]}: exists already and is not overwritten")


def test_the_folder_of_a_page_is_not_written_into(tmp_path: Path) -> None:
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "mine.svg").touch()
    empty_inputs(("report", "no"), tmp_path)
    for page, said in (
        ("page.html", "page: the page's figures go there"),
        ("my.page", "name a file that ends in .html"),
    ):
        assert said in rig("report", "no", "-o", page, cwd=tmp_path).stderr


def test_every_path_that_a_command_reads_is_looked_for_first() -> None:
    # a record that is followed may not be there yet
    written = {("init", "file"), ("view", "record")}
    unchecked = {
        (*name, item.name)
        for name, command in commands(typer.main.get_command(app))
        for item in command.params
        if item.type_descriptor.annotation in (Path, Path | None, list[Path]) and item.callback is None
    }
    # of an archive every command says itself how one is made
    archives = {name for name in unchecked if name[-1] == "archive"}
    assert unchecked - archives == {*written, ("export", "output")}


def test_every_option_that_names_an_output_is_checked() -> None:
    unchecked = [
        (*name, item.opts[0])
        for name, command in commands(typer.main.get_command(app))
        for item in command.params
        if {"-o", "--rrd", "--history-file"} & set(item.opts) and item.callback is None
    ]
    # which of two checks it needs depends on its --format
    assert unchecked == [("export", "-o")]


def test_results_that_become_the_newest_of_a_session_are_named(tmp_path: Path) -> None:
    """rig fit left results-2.json inside the session, and report and replay took it without a word."""
    shutil.copytree(SAMPLES / "first", tmp_path / "first")
    done = rig("fit", "first", cwd=tmp_path)
    assert "results-2.json is the newest of first now" in done.stderr
    done = rig("export", "first", "-o", "out", cwd=tmp_path)
    assert "first: results-2.json, the newest of its results, is taken" in done.stderr
    done = rig("export", "first/results.json", "-o", "earlier", cwd=tmp_path)
    assert "newest" not in done.stderr
