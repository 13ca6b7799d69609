"""What the wizards of all calibrations share: answers in, the command's file and the result out."""

import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition import atomic_write
from acquisition.record import records_of
from calibration import CalibrationFile, read_calibration, toml_value
from processing.errors import ConfigurationError, RecordError
from rig.calibrate import Filing, Residuals, calibration_residuals, calibration_tables
from rig.measure import record_plainly, take_frames
from rig.presentation import Table
from rig.settings import Configuration
from rig.wizards.question import Question, RecordedAnswer


@dataclass(frozen=True, slots=True)
class CalibrationWizard:
    """A `Wizard` whose answers become a calibration file; `kind` is that of ``rig calibrate KIND``.

    `file` makes the calibration of the values by the command's own function and returns its file. A file
    that the command reads is written first, into the same folder. It raises RigError where the measurement
    does not serve; what was written so far stays.
    """

    kind: str
    title: str
    questions: Callable[[Mapping[str, Any]], Iterator[Question]]
    file: Callable[[Mapping[str, Any], Filing], Path]


@dataclass(frozen=True, slots=True)
class Filed:
    """A calibration that was made: its file, content, tables, and the lines for the configuration.

    `residuals` are what its fit has left over.
    """

    path: Path
    calibration: CalibrationFile
    tables: Sequence[Table]
    residuals: Sequence[Residuals]
    configuration: str


def filed(path: Path) -> Filed:
    """What to show of a new calibration file."""
    found = read_calibration(path)
    name = toml_value(path.as_posix())
    stated = f"checks = [{name}]" if found.kind == "check" else f"{found.kind} = {name}"
    state = f"[calibration]\n{stated}"
    return Filed(path, found, calibration_tables(found), calibration_residuals(found), state)


def write_table(folder: Path, stem: str, tree: Mapping[str, Any]) -> Path:
    """Write tables as TOML into STEM-001.toml, or the next number that is free; returns the file.

    Paths are stated relative to the folder. Raises RecordError if it cannot be written.
    """
    text = "\n".join(_lines(tree, folder)) + "\n"
    # what is written here is read by another: better to fail now
    tomllib.loads(text)
    number = 1
    try:
        folder.mkdir(parents=True, exist_ok=True)
        while True:
            path = folder / f"{stem}-{number:03d}.toml"
            try:
                atomic_write.write_new(path, text.encode())
            except FileExistsError:
                number += 1
            else:
                return path
    except OSError as error:
        raise RecordError(f"{folder}: cannot write {stem}: {error.strerror or error}") from None


def next_free(folder: Path, stem: str, suffix: str = "") -> Path:
    """The first of STEM-001, STEM-002 ... that does not exist."""
    number = 1
    while (path := folder / f"{stem}-{number:03d}{suffix}").exists():
        number += 1
    return path


def recorder_of(config: Configuration, source: Path, folder: Path) -> Callable[[RecordedAnswer], Path]:
    """Records into new files and folders of `folder`; the function returns what it has made.

    It raises RigError where that fails.
    """

    def record(wanted: RecordedAnswer) -> Path:
        path = place_for(wanted, folder)
        if wanted.kind == "record":
            return record_plainly(config, source, path, wanted.seconds)
        exposed = config
        if wanted.exposure_us is not None:
            camera = config.camera.model_copy(update={"exposure_us": wanted.exposure_us})
            exposed = config.model_copy(update={"camera": camera})
        return take_frames(exposed, path, wanted.frames)

    return record


def place_for(wanted: RecordedAnswer, folder: Path) -> Path:
    """A new name in `folder` for what is recorded."""
    return next_free(folder / "records", wanted.name, ".mcap" if wanted.kind == "record" else "")


def a_record(text: str) -> Path:
    """Reads the name of a record that exists; raises ConfigurationError for anything else."""
    path = Path(text).expanduser()
    if path.is_dir():
        records = records_of(path)
        if len(records) != 1:
            raise ConfigurationError(f"{text}: holds {len(records)} records; name one of them")
        return records[0]
    if path.suffix != ".mcap" or not path.is_file():
        raise ConfigurationError(f"{text}: there is no such record; name an MCAP file")
    return path


def yes_or_no(text: str) -> bool:
    """Reads an answer of yes or no."""
    return text == "yes"


def first_positive(read: Callable[[str], float], what: str) -> Callable[[str], float]:
    """Reads the same, above 0."""

    def positive(text: str) -> float:
        value = read(text)
        if value <= 0:
            raise ConfigurationError(f"{text!r}: {what} should be greater than 0")
        return value

    return positive


def _lines(tree: Mapping[str, Any], folder: Path) -> Iterator[str]:
    for key, value in tree.items():
        if not isinstance(value, Mapping) and not _is_list_of_tables(value):
            yield f"{key} = {toml_value(_relative(value, folder))}"
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from ("", f"[{key}]", *_lines(value, folder))
        elif _is_list_of_tables(value):
            for table in value:
                yield from ("", f"[[{key}]]", *_lines(table, folder))


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)


def _relative(value: Any, folder: Path) -> Any:
    return Path(os.path.relpath(value, folder)) if isinstance(value, Path) else value
