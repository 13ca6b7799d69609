"""Files `.eln`, as electronic laboratory notebooks exchange them: an RO-Crate as a zip of one folder.

As the ELN Consortium's file format has it (github.com/TheELNConsortium/TheELNFileFormat).
"""

import hashlib
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath

from acquisition.record.whole_file import folder_being_written
from processing.errors import ConfigurationError, RecordError
from rig.archive.crates import METADATA, check_described, described_files

_SUFFIX = ".eln"
_BLOCK = 1 << 20
_ENCRYPTED = 1
"""Bit of an entry's flags."""
_OF_MACOS, _OF_FINDER = "__MACOSX", ".DS_Store"
"""Folder and file that macOS adds to what it zips: icons and attributes, nothing of the crate."""


def is_eln(path: Path) -> bool:
    """Whether a file is named as one of a notebook."""
    return path.suffix.lower() == _SUFFIX


def write_eln(folder: Path, name: str, output: Path) -> None:
    """Write a crate as a zip in which it is a folder of this name."""
    with zipfile.ZipFile(output, "x", strict_timestamps=False) as archive:
        for path in (folder, *sorted(folder.rglob("*"))):
            # the chunks of a record are compressed already
            kind = zipfile.ZIP_STORED if path.suffix == ".mcap" else zipfile.ZIP_DEFLATED
            archive.write(path, PurePosixPath(name, path.relative_to(folder)), kind)


def check_eln(path: Path) -> None:
    """Every file in it is described, and everything described is in it with the hash that is stated."""
    with _Eln.opened(path) as eln:
        check_described(eln.described, {name: eln.sha256(name) for name in eln.files}, str(path))


def unpacked(path: Path) -> Path:
    """The folder of a file's name beside it, with what is in the file, made now or known from before.

    Raises ConfigurationError where something else has that name; RecordError where the file is none, or what
    is in it is not as it says.
    """
    folder = path.with_suffix("")
    with _Eln.opened(path) as eln:
        try:
            with folder_being_written(folder) as beside:
                for name in (METADATA, *eln.files):
                    target = beside / name
                    target.parent.mkdir(parents=True, exist_ok=True)
                    digest = hashlib.sha256()
                    with target.open("xb") as file:
                        for block in eln.blocks(name):
                            digest.update(block)
                            file.write(block)
                    if eln.described.get(name) not in (None, digest.hexdigest()):
                        raise RecordError(f"{path}: {name} does not have the hash that {METADATA} states")
        except FileExistsError:
            # it has taken its name with all that is in it
            if (folder / METADATA).is_file() and (folder / METADATA).read_bytes() == eln.metadata:
                return folder
            raise ConfigurationError(
                f"{path}: unpacks into {folder}, which already exists and holds something else; rename one"
            ) from None
        except OSError as error:
            raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return folder


class _Eln:
    """An open file, whose names are as the format asks."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        self._entries: dict[str, zipfile.ZipInfo] = {}
        roots = set()
        for entry in archive.infolist():
            place = PurePosixPath(entry.filename)
            if place.parts[:1] in ((_OF_MACOS,), (_OF_FINDER,)):
                continue
            inside = PureWindowsPath(*place.parts[1:])
            if place.is_absolute() or ".." in inside.parts or inside.anchor or "\\" in entry.filename:
                raise RecordError(f"{path}: {entry.filename!r} in it would lie outside of its folder")
            roots.add(place.parts[0] if place.parts else "")
            if entry.is_dir():
                continue
            name = PurePosixPath(*place.parts[1:]).as_posix()
            if len(place.parts) == 1 or name in self._entries:
                raise RecordError(f"{path}: {entry.filename!r} in it is not in a folder, or occurs twice")
            if entry.flag_bits & _ENCRYPTED:
                raise RecordError(f"{path}: is encrypted; unpack it with its password, and add the folder")
            self._entries[name] = entry
        for name in self._entries:
            if above := {str(folder) for folder in PurePosixPath(name).parents} & self._entries.keys():
                raise RecordError(f"{path}: {above.pop()!r} in it is a file and a folder")
        if len(roots) != 1 or METADATA not in self._entries:
            raise RecordError(f"{path}: is not an .eln file: it must hold one folder, and in that {METADATA}")
        self.metadata = b"".join(self.blocks(METADATA))
        self.described = described_files(self.metadata, str(path))
        added = {name for name in self._entries if PurePosixPath(name).name == _OF_FINDER}
        self.files = sorted(self._entries.keys() - {METADATA} - (added - self.described.keys()))
        if missing := sorted(self.described.keys() - self._entries.keys()):
            raise RecordError(f"{path}: {missing[0]} is described and not in it")

    @classmethod
    @contextmanager
    def opened(cls, path: Path) -> Iterator["_Eln"]:
        try:
            archive = zipfile.ZipFile(path)
        except zipfile.BadZipFile as error:
            raise RecordError(f"{path}: is not an .eln file: {error}") from None
        except OSError as error:
            raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
        with archive:
            yield cls(path, archive)

    def blocks(self, name: str) -> Iterator[bytes]:
        """The content of a file in it. Raises RecordError where it is damaged."""
        try:
            with self._archive.open(self._entries[name]) as file:
                while block := file.read(_BLOCK):
                    yield block
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
            raise RecordError(f"{self._path}: {name} in it cannot be read: {error}") from None

    def sha256(self, name: str) -> str:
        """Hash of a file in it."""
        digest = hashlib.sha256()
        for block in self.blocks(name):
            digest.update(block)
        return digest.hexdigest()
