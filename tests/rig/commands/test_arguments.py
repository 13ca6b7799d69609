"""What commands take: choices, which are written where help must come at once, and files by what they are."""

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import typer

from rig.archive.updating import Level
from rig.cli import GROUPS, app
from rig.commands.arguments import kind_of
from rig.report.export import Format as ExportFormat
from rig.settings.configuration import ViewSettings
from rig.view import LayoutName, Mode
from tests.rig.command_line import CONFIGS, rig
from tests.rig.commands.wrong_inputs import commands


def test_every_command_stands_under_one_heading() -> None:
    listed = [name for names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted(typer.main.get_command(app).commands)  # type: ignore[attr-defined]


def test_a_file_is_fitted_as_what_it_is(tmp_path: Path) -> None:
    for name in ("run.mcap", "decay.csv", "decay.tsv", "swing.mp4", "swing.gif", "one.tif", "mine.toml"):
        (tmp_path / name).touch()
    np.save(tmp_path / "columns.npy", np.zeros((5, 2)))
    np.save(tmp_path / "stack.npy", np.zeros((5, 4, 4), np.uint8))
    for folder, name in (
        ("images", "f1.png"),
        ("films", "a.mkv"),
        ("session", "run-1.mcap"),
        ("fit", "results.json"),
    ):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).touch()
    (tmp_path / "session" / "picture.png").touch()
    (tmp_path / "fit" / "figure.png").touch()
    kinds = {path.name: kind_of(path) for path in tmp_path.iterdir()}
    assert {name for name, kind in kinds.items() if kind == "film"} == {
        "swing.mp4", "swing.gif", "one.tif", "stack.npy", "images", "films",
    }  # fmt: skip
    assert {name for name, kind in kinds.items() if kind == "records"} == {"run.mcap", "session", "fit"}


@pytest.mark.parametrize(
    ("name", "words", "said"),
    [
        ("run.mcap", ("--pixel", "1 mm"), "--pixel: has no effect on records, only on a table or a film"),
        ("run.mcap", ("--rate", "0"), "--rate: has no effect on records, only on a table or a film"),
        ("run.mcap", ("--from", "0"), "--from: has no effect on records, only on a table or a film"),
        ("decay.csv", ("--dark",), "--dark: has no effect on a table"),
        ("swing.mp4", ("--time", "t"), "--time: has no effect on a film"),
        ("swing.mp4", ("--force-rate",), "--force-rate: needs --rate"),
    ],
)
def test_what_has_no_effect_is_refused(name: str, words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    done = rig("fit", name, *words, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--record-only",), "takes CONFIG, -o NAME.mcap, --seconds"),
        (
            ("--record-only", "-o", "one.mcap", "--runs", "2"),
            "takes CONFIG, -o NAME.mcap, --seconds",
        ),
        (("--record-only", "-o", "one"), "one: name a file that ends in .mcap"),
        (("-o", "one.mcap"), "one.mcap: one record is written with --record-only; else name a folder"),
        (("--seconds", "9"), "--seconds 9: has no effect without --record-only"),
    ],
)
def test_one_record_alone(words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = rig("run", CONFIGS / "demo.toml", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "option", "choices"),
    [
        (("export",), "--format", get_args(ExportFormat)),
        (("archive", "refit"), "--level", get_args(Level)),
        (("view",), "--layout", get_args(LayoutName)),
    ],
)
def test_a_command_offers_what_its_room_takes(
    command: tuple[str, ...], option: str, choices: tuple[Any, ...]
) -> None:
    found = dict(commands(typer.main.get_command(app)))[command]
    (shown,) = [item for item in found.params if option in item.opts]
    assert {*get_args(shown.type_descriptor.annotation)} == {*choices}


@pytest.mark.parametrize(("key", "choices"), [("mode", get_args(Mode)), ("layout", get_args(LayoutName))])
def test_a_key_of_the_view_takes_what_the_view_knows(key: str, choices: tuple[str, ...]) -> None:
    assert get_args(ViewSettings.model_fields[key].annotation) == choices
