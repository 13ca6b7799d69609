"""Choices of commands and keys, which are written where help must come at once, are those of the rooms."""

from typing import Any, get_args

import pytest
import typer

from rig.archive.updating import Level
from rig.cli import app
from rig.report.export import Format as ExportFormat
from rig.settings.configuration import ViewSettings
from rig.view import LayoutName, Mode
from tests.rig.commands.wrong_inputs import commands


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
