"""Arguments and options that several commands share, with checks of the paths to read and to write."""

import functools
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from typer.core import TyperCommand

from acquisition.record import records_in_folder, resolve_records
from processing.errors import ConfigurationError

if TYPE_CHECKING:
    from rig.settings import Configuration

_Paths = TypeVar("_Paths", Path, list[Path], Path | None, list[Path] | None)
_KINDS = {"": "file or folder", ".mcap": "record", ".toml": "file", ".rrd": "Rerun file"}
_MAX_LISTED = 5
"""Names that a message on a missing file lists."""
PAGES = (".html", ".htm")
"""Suffixes of an HTML page."""


def existing(paths: _Paths) -> _Paths:
    """Check that files and folders exist; their readers check the contents."""
    return _existing(paths, "")


def existing_toml(remedy: str) -> Callable[[Path | None], Path | None]:
    """A check that a TOML file exists which is no configuration; `remedy` says where one comes from."""

    # a function of the path alone, because typer would pass the path as the last parameter
    def check(path: Path | None) -> Path | None:
        return _existing(path, remedy)

    return check


def _existing(paths: _Paths, toml_remedy: str) -> _Paths:
    """Check paths; `toml_remedy` says where a TOML file comes from that is no configuration."""
    for path in _path_list(paths):
        try:
            path.stat()
        except (FileNotFoundError, NotADirectoryError):
            if "=" in path.name:
                raise ConfigurationError(
                    f"{path}: no such file; a key of the configuration is changed by --set {path}"
                ) from None
            kind = _KINDS.get(path.suffix.lower(), "file")
            raise ConfigurationError(f"{path}: no such {kind}{_alternatives(path, toml_remedy)}") from None
        except (OSError, ValueError):
            # inaccessible, or not a valid name: the reader's message is better
            continue
    return paths


def _check_each(check: Callable[[Path], object], *, is_read: bool = True) -> Callable[[_Paths], _Paths]:
    """A check of every path of a parameter; a path that is read must also exist."""

    def check_all(paths: _Paths) -> _Paths:
        for path in _path_list(existing(paths) if is_read else paths):
            check(path)
        return paths

    return check_all


@_check_each
def record_input(path: Path) -> None:
    """Check that records exist; a folder must hold one."""
    resolve_records(path)


@_check_each
def fit_input(path: Path) -> None:
    """Check the input of `rig fit`: records, a table, a film, or folders of them exist."""
    if kind_of(path) == "records":
        resolve_records(path)


def kind_of(path: Path) -> Literal["records", "table", "film"]:
    """The kind of the input of `rig fit` at a path, by its name; of an array by its dimensions.

    A folder without records, images or films counts as a folder of records.
    """
    suffix = path.suffix.lower()
    if suffix in (".mcap", ".csv", ".txt", ".toml", ".json"):
        return "records" if suffix == ".mcap" else "table"
    if path.is_dir() and (records_in_folder(path) or any(path.glob("results*.json"))):
        return "records"
    # imported here: the readers of films take a second
    from rig.intake.film import is_filmed

    if path.is_dir():
        return "film" if is_filmed(path) else "records"
    return "film" if is_filmed(path) else "table"


@_check_each
def record_or_results(path: Path) -> None:
    """Check that records exist, or results that rig fit made of a table or a film."""
    if not is_of_table(path):
        resolve_records(path)


def is_of_table(path: Path) -> bool:
    """Whether a path holds results of a table or a film: there are results and no record."""
    folder = path if path.is_dir() else path.parent
    return (
        (path.is_dir() or path.suffix.lower() == ".json")
        and not any(folder.glob("*.mcap"))
        and any(folder.glob("results*.json"))
    )


@_check_each
def results_folder(path: Path) -> None:
    """Check that files exist, and that folders of sessions, or of several sessions, hold results."""
    # the folder of a list of sessions has results in its subfolders
    if path.is_dir() and not (any(path.glob("results*.json")) or any(path.glob("*/results*.json"))):
        raise ConfigurationError(
            f"{path}: holds no results.json; rig run makes one, and rig fit from records"
        )
    if any(path.glob("results-*.json")):
        from rig.analysis import results_path
        from rig.terminal import say

        newest = results_path(path)
        say(f"{path}: {newest.name}, the newest of its results, is taken; name others to take them")


def one_record(path: Path) -> Path:
    """The record itself, or the only one of a folder; raises ConfigurationError for none or several."""
    records = resolve_records(path)
    if len(records) > 1:
        names = ", ".join(record.name for record in records)
        raise ConfigurationError(f"{path}: holds {len(records)} records; name one of them: {names}")
    return records[0]


def _path_list(paths: Path | list[Path] | None) -> Sequence[Path]:
    return paths if isinstance(paths, list) else [] if paths is None else [paths]


def _alternatives(path: Path, toml_remedy: str) -> str:
    """End of the message on a missing file: others of its kind in the folder, and how to make one."""
    remedy = {
        "": "; put a name with spaces in quotes",
        ".toml": f"; {toml_remedy or 'rig init writes a configuration'}",
        ".mcap": "; give the path of a record, which rig run makes",
    }.get(path.suffix.lower(), "")
    if path.suffix.lower() == ".toml" and not toml_remedy:
        from rig.settings import shipped_names

        if path.stem in shipped_names():
            remedy = f"; rig init --example {path.stem} writes {path.name} here"
    if not path.parent.is_dir():
        return f"; there is no folder {path.parent}{remedy}"
    try:
        others = [other for other in path.parent.iterdir() if other.suffix == path.suffix]
    except OSError:
        return remedy
    names = sorted(other.name for other in others if path.suffix or other.is_dir())
    names = [name for name in names if name != "pyproject.toml"]
    listed = ", ".join([*names[:_MAX_LISTED], *(["..."] if len(names) > _MAX_LISTED else [])])
    return (f"; {path.parent} has {listed}" if names else "") + remedy


Check = Callable[[Path | None], Path | None]


def _output(check: Callable[[Path], object]) -> Check:
    """A check of a path to write, if one is stated."""
    return _check_each(check, is_read=False)


def new_file(*suffixes: str, makes_folders: bool = False) -> Check:
    """A check for a new file, with one of these suffixes if any are given.

    Its folder must exist, unless the command makes folders.
    """

    @_output
    def check(path: Path) -> None:
        if path.is_dir():
            raise ConfigurationError(f"{path}: is a folder; name a file in it")
        if suffixes and path.suffix.lower() not in suffixes:
            raise ConfigurationError(f"{path}: name a file that ends in {' or '.join(suffixes)}")
        _refuse_existing(path)
        if not makes_folders and not path.parent.is_dir():
            raise ConfigurationError(f"{path}: there is no folder {path.parent}; make it, or name another")
        _refuse_unwritable(path)

    return check


@_output
def new_page(path: Path) -> None:
    """Check that an HTML page, and the folder of its name for figures and tables, do not exist."""
    new_file(*PAGES, makes_folders=True)(path)
    if path.with_suffix("").is_dir() and any(path.with_suffix("").iterdir()):
        raise ConfigurationError(
            f"{path.with_suffix('')}: the page's figures go there, and it is not empty; choose another name"
        )


_FILE_SUFFIXES = {
    ".csv", ".h5", ".hdf5", ".html", ".json", ".mcap", ".nxs", ".parquet", ".pdf", ".png", ".rrd", ".tex",
    ".toml", ".tsv", ".txt", ".xlsx", ".zip",
}  # fmt: skip


def folder_without(*patterns: str) -> Check:
    """A check for a folder without files of these names; a missing folder will be made."""

    @_output
    def check(path: Path) -> None:
        if path.exists() and not path.is_dir():
            raise ConfigurationError(f"{path}: is a file; name a folder")
        if not path.exists() and path.suffix.lower() in _FILE_SUFFIXES:
            raise ConfigurationError(
                f"{path}: is the name of a file, and a folder is written; name it without {path.suffix}"
            )
        for pattern in patterns:
            for file in sorted(path.glob(pattern)):
                _refuse_existing(file, "folder")
        _refuse_unwritable(path)

    return check


folder_without_run = folder_without("run-*.mcap", "results.json")


@_output
def folder_or_record(path: Path) -> None:
    """Check that a folder holds no run, or that a record (MCAP file) does not exist."""
    is_record = path.suffix.lower() == ".mcap"
    (new_file(".mcap", makes_folders=True) if is_record else folder_without_run)(path)


@_output
def new_folder(path: Path) -> None:
    """Check that a folder does not exist."""
    _refuse_existing(path)
    _refuse_unwritable(path)


@_output
def present_folder(path: Path) -> None:
    """Check that a folder exists."""
    if not path.is_dir():
        problem = "is a file" if path.exists() else "no such folder"
        raise ConfigurationError(f"{path}: {problem}; name a folder that is there")
    _refuse_unwritable(path)


@_output
def appended_file(path: Path) -> None:
    """Check that a file can be appended to; a missing file is made with its folders."""
    if path.is_dir():
        raise ConfigurationError(f"{path}: is a folder; name a file in it")
    _refuse_unwritable(path)


def _refuse_existing(path: Path, alternative: str = "name") -> None:
    if os.path.lexists(path):
        raise ConfigurationError(
            f"{path}: exists already and is not overwritten; choose another {alternative}"
        )


def _refuse_unwritable(path: Path) -> None:
    """Raise ConfigurationError if the path, or the nearest folder above it that exists, is read-only."""
    ancestor = path.absolute()
    while not os.path.lexists(ancestor) and ancestor != ancestor.parent:
        ancestor = ancestor.parent
    if ancestor != path.absolute() and not ancestor.is_dir():
        raise ConfigurationError(f"{path}: {ancestor} is not a folder; name another place")
    if not os.access(ancestor, os.W_OK | (os.X_OK if ancestor.is_dir() else 0)):
        raise ConfigurationError(
            f"{path}: cannot be written: {ancestor} is read-only for you; name another place"
        )


def input_argument(help_: str, check: Callable[..., object] = existing, **options: Any) -> Any:
    """The argument for a path that a command reads."""
    return typer.Argument(help=help_, show_default=False, callback=check, **options)


def input_option(help_: str, *names: str, check: Callable[..., object] = existing, **options: Any) -> Any:
    """The option for a path that a command reads."""
    return typer.Option(*names, help=help_, show_default=False, callback=check, **options)


def output_option(
    help_: str, check: Check | None = None, *, names: Sequence[str] = ("-o", "--output"), **options: Any
) -> Any:
    """The option for a path to which a command writes."""
    return typer.Option(*names, help=help_, callback=check, **options)


Config = Annotated[Path, input_argument("Configuration (TOML file).")]
Record = Annotated[Path, input_argument("Record (MCAP file), or a folder with one.", record_input)]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one key of the configuration for this call, by its dotted path; may be repeated.",
    ),
]
View = Annotated[
    Literal["window", "web"] | None,
    typer.Option(
        "--view",
        help="Show it live: in a window (also --view alone), or as a web page on this machine.",
        show_default=False,
    ),
]
MODES: dict[str | None, Literal["none", "spawn", "web"]] = {None: "none", "window": "spawn", "web": "web"}
"""Values of view.mode."""
ResultsFolder = Annotated[
    Path | None,
    output_option("Folder for results.json; must not hold one yet.", folder_without("results.json")),
]
JsonLines = Annotated[bool, typer.Option("--json", help="Write one JSON object per line to stdout.")]
Where = Annotated[str, typer.Option(help="Only runs that meet a condition, as in rig archive list.")]


_AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout, everything else on stderr.")
]


def in_json(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the option ``--json``, which prints the values given to `rig.terminal.answer`."""

    @functools.wraps(command)
    def with_option(*args: Any, as_json: bool = False, **kwargs: Any) -> None:
        if not as_json:
            command(*args, **kwargs)
            return
        from rig.terminal import one_json_object

        status = 0
        with one_json_object():
            try:
                command(*args, **kwargs)
            except typer.Exit as error:
                status = error.exit_code
        raise typer.Exit(status)

    signature = inspect.signature(command)
    option = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_AsJson)
    parameters = [*signature.parameters.values(), option]
    vars(with_option)["__signature__"] = signature.replace(parameters=parameters)
    return with_option


class ListingCommand(TyperCommand):
    """A command whose help shows the type of each of several values instead of Python's `list[...]`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for parameter in self.params:
            annotation = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
            if get_origin(annotation) is list:
                entry_type = get_args(annotation)[0]
                text = "<path>" if entry_type is Path else f"<{entry_type.__name__}>"
                vars(parameter)["display_type"] = lambda _context, text=text: text


def group(name: str, help_: str, *commands: Callable[..., None]) -> typer.Typer:
    """A command with subcommands, which have the names of their functions."""
    app = typer.Typer(name=name, help=help_, no_args_is_help=True)
    for command in commands:
        app.command(command.__name__.rstrip("_"), cls=ListingCommand)(command)
    return app


def configuration_of(config: Path, set_: Sequence[str] | None) -> "Configuration":
    """The configuration of a file and of `--set`."""
    from rig.settings import load_configuration

    return load_configuration(config, set_ or [])


def print_written(*paths: Path) -> None:
    """Print the files that a command has written."""
    from rig.terminal import answer

    for path in paths:
        answer(written=[path])
        print(path)


def refuse_options(reason: str, *groups: Mapping[str, object]) -> None:
    """Raise ConfigurationError for the first option, by name, that is stated."""
    for name, value in (option for options in groups for option in options.items()):
        if value:
            raise ConfigurationError(f"{name}: has no effect {reason}")
