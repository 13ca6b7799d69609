"""Where commands may write: what is there already, or cannot be written, is refused before the work.

Each function but `output_option` is, or makes, the callback of an option; that returns the path as it is, or
raises ConfigurationError.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from processing.errors import ConfigurationError

Check = Callable[[Path | None], Path | None]


def output_option(help_: str, check: Check | None = None, *, show_default: bool = True) -> Any:
    """The option that says where a command writes."""
    return typer.Option("-o", "--output", help=help_, show_default=show_default, callback=check)


def new_file(*suffixes: str, makes_folders: bool = False) -> Check:
    """For a file that must not exist, with one of these suffixes if there are any.

    Its folder must be there, unless the command makes folders.
    """

    def check(path: Path | None) -> Path | None:
        if path is None:
            return None
        if path.is_dir():
            raise ConfigurationError(f"{path}: is a folder; name a file in it")
        if suffixes and path.suffix.lower() not in suffixes:
            raise ConfigurationError(f"{path}: name a file that ends in {' or '.join(suffixes)}")
        _refuse_existing(path)
        if not makes_folders and not path.parent.is_dir():
            raise ConfigurationError(f"{path}: there is no folder {path.parent}; make it, or name another")
        _refuse_unwritable(path)
        return path

    return check


def new_page(path: Path | None) -> Path | None:
    """For an HTML page that must not exist, nor the folder of its name for figures and tables."""
    new_file(".html", ".htm", makes_folders=True)(path)
    if path is not None and path.with_suffix("").is_dir() and any(path.with_suffix("").iterdir()):
        raise ConfigurationError(
            f"{path.with_suffix('')}: the page's figures go there, and it is not empty; choose another name"
        )
    return path


def page_or_campaign(path: Path | None) -> Path | None:
    """For an HTML page that must not exist, or the folder of a campaign, in which none may be."""
    if path is not None and path.suffix.lower() in (".html", ".htm"):
        return new_page(path)
    return folder_without("campaign.json", "campaign.html")(path)


def folder_without(*patterns: str) -> Check:
    """For a folder, which is made where it is missing, in which nothing may be of these names."""

    def check(path: Path | None) -> Path | None:
        if path is None:
            return None
        if path.exists() and not path.is_dir():
            raise ConfigurationError(f"{path}: is a file; name a folder")
        for pattern in patterns:
            for taken in sorted(path.glob(pattern)):
                _refuse_existing(taken, "folder")
        _refuse_unwritable(path)
        return path

    return check


def folder_or_record(path: Path | None) -> Path | None:
    """For the folder of a session, in which no run may be, or a record that must not exist (MCAP file)."""
    if path is not None and path.suffix.lower() == ".mcap":
        return new_file(".mcap", makes_folders=True)(path)
    return folder_without("run-*.mcap", "results.json")(path)


def new_folder(path: Path | None) -> Path | None:
    """For a folder that must not exist."""
    if path is not None:
        _refuse_existing(path)
        _refuse_unwritable(path)
    return path


def old_folder(path: Path | None) -> Path | None:
    """For a folder that must exist."""
    if path is not None and not path.is_dir():
        what = "is a file" if path.exists() else "no such folder"
        raise ConfigurationError(f"{path}: {what}; name a folder that is there")
    if path is not None:
        _refuse_unwritable(path)
    return path


def appended_file(path: Path | None) -> Path | None:
    """For a file to which lines are added; it is made, with its folders, where it is missing."""
    if path is not None and path.is_dir():
        raise ConfigurationError(f"{path}: is a folder; name a file in it")
    if path is not None:
        _refuse_unwritable(path)
    return path


def _refuse_existing(path: Path, what: str = "name") -> None:
    if os.path.lexists(path):
        raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another {what}")


def _refuse_unwritable(path: Path) -> None:
    """Raise ConfigurationError where the path, or the folder in which it would be made, is read-only."""
    place = path.absolute()
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    if place != path.absolute() and not place.is_dir():
        raise ConfigurationError(f"{path}: {place} is not a folder; name another place")
    if not os.access(place, os.W_OK | (os.X_OK if place.is_dir() else 0)):
        raise ConfigurationError(
            f"{path}: cannot be written: {place} is read-only for you; name another place"
        )
