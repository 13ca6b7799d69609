"""A configuration that comes with the program, written for who wants to try or change it."""

from pathlib import Path

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from rig.settings import read_toml, shipped


def copy_shipped(name: str, path: Path) -> list[Path]:
    """Write a configuration as `path`, and those that it extends beside it; returns the files written.

    What it extends keeps its name, which the file states; what lies there already with the same text stays.

    Raises
    ------
    ConfigurationError
        No such configuration, or a file is there that says something else. Nothing is written then.
    RecordError
        A file cannot be written.
    """
    texts, source = {}, shipped(name)
    target = path
    while True:
        texts[target] = source.read_bytes()
        base = read_toml(source, "configuration").get("extends")
        if base is None:
            break
        source, target = source.parent / base, path.parent / base
    missing = {target: text for target, text in texts.items() if not _holds(target, text)}
    for target, text in missing.items():
        try:
            whole_file.write_new(target, text)
        except OSError as error:
            raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return list(missing)


def _holds(path: Path, text: bytes) -> bool:
    if not path.exists():
        return False
    if path.is_file() and path.read_bytes() == text:
        return True
    raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another folder or name")
