"""Results made again of records in an archive: a file for each, with the code that made it; all are kept."""

import datetime
import functools
import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import zstandard

from acquisition.record.digest import sha256_of
from processing.errors import ConfigurationError, RecordError, RigError
from rig.analysis import (
    AnalysedRun,
    RunResults,
    analyse_record,
    chosen_laws,
    decoded,
    encoded,
    laws_of,
    session_results,
)
from rig.archive.proved import read_file, with_frame, without_frame
from rig.archive.remote import is_remote, write_new
from rig.archive.session_rows import now_utc, row_of_results
from rig.archive.shelf import unreadable
from rig.archive.store import REFIT_SUFFIX, refit_shelf
from rig.instrument import versions
from rig.replay import analyse_replayed

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("rig", "acquisition", "calibration", "processing")
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless")


@functools.cache
def code_identity() -> str:
    """For example `0.1.0 (394556fc) 5f1c0e9d0a7b3c24`; equal where the same sources would run.

    The commit alone does not say it: a checkout may be changed, an installation has none.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode() + path.read_bytes())
    known = versions()
    digest.update("".join(f"{name} {known[name]}\n" for name in _LIBRARIES).encode())
    return f"{known['optical-pendulum-rig']} ({known['commit'][:8]}) {digest.hexdigest()[:16]}"


Level = Literal["swings", "spots", "pixels"]


@dataclass(frozen=True)
class Recipe:
    """From what results are made, with which laws and settings, by which code."""

    level: Level
    laws: tuple[str, ...]
    settings: tuple[str, ...]
    code: str

    def name(self, sha256: str) -> str:
        """Name of the file with the results of one record."""
        parts = (sha256, self.level, "\0".join(self.laws), "\0".join(self.settings), self.code)
        return f"{sha256[:16]}-{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]}"


class Task(NamedTuple):
    """One record, to be made results of; `sha256` is the record's as the archive knows it.

    `archive` is a folder, or the URL of a remote archive, to which the results are sent at once. `turn` is
    larger than that of all results that were there when the work began: the largest are the newest.
    `public_key` is that of a blind archive.
    """

    archive: str
    record: Path
    sha256: str
    recipe: Recipe
    turn: int = 0
    public_key: str = ""


@dataclass(frozen=True)
class Refit:
    """A file of results as it was written; `results` is None where `problem` says why there are none."""

    name: str
    recipe: Recipe
    made_utc: datetime.datetime
    problem: str
    results: RunResults | None
    turn: int = 0

    @property
    def order(self) -> tuple[int, datetime.datetime, str]:
        """Later results come later, whatever the clocks say; those without a turn come first."""
        return self.turn, self.made_utc, self.name


def refit(task: Task) -> str:
    """Make and store the results of one record; says what hindered it, or nothing.

    What lies in the record itself (nothing to fit, no pixels) is stored as the results' problem, because it
    would be found again each time. What may be remedied is not.
    """
    recipe, name = task.recipe, task.recipe.name(task.sha256)
    # a commit may change no source: then the same would run
    if code_identity().rpartition(" ")[2] != recipe.code.rpartition(" ")[2]:
        return f"this worker runs other code ({code_identity()}) than was asked for ({recipe.code})"
    try:
        if sha256_of(task.record) != task.sha256:
            return f"{task.record}: has changed since it was added; rig archive add"
    except RecordError as error:
        return str(error)
    row: dict[str, Any] = {"sha256": task.sha256, "version": name}
    results = None
    try:
        run = _analysed(task)
        made = session_results([run], task.record.parent, task.public_key)
        results = encoded(made)
        row |= row_of_results(made.runs[0])
    except ConfigurationError as error:
        return str(error)
    except RigError as error:
        row["problem"] = str(error)
    document = {
        "version": name,
        "sha256": task.sha256,
        "turn": task.turn,
        "made_utc": now_utc().isoformat(),
        "level": recipe.level,
        "laws": recipe.laws,
        "settings": recipe.settings,
        "code": recipe.code,
        "row": row,
        "results": results,
    }
    compressor = zstandard.ZstdCompressor(level=6, write_checksum=True)
    packed = with_frame(compressor.compress(json.dumps(document).encode()))
    if is_remote(task.archive):
        write_new(task.archive, f"refits/{name}{REFIT_SUFFIX}", packed)
    else:
        refit_shelf(Path(task.archive)).write(name, packed)
    return ""


def _analysed(task: Task) -> AnalysedRun:
    recipe = task.recipe
    if recipe.level == "swings":
        run = analyse_record(task.record, recipe.settings)
    else:
        run = analyse_replayed(task.record, retrack=recipe.level == "pixels", overrides=recipe.settings)
    if recipe.laws:
        compared = laws_of(run, chosen_laws(recipe.laws))
        run = replace(run, results=replace(run.results, laws=compared))
    return run


def read_refit(path: Path) -> Refit:
    """One file of results. Raises RecordError where it cannot be understood."""
    try:
        packed = without_frame(path, read_file(path))
        tree = json.loads(zstandard.ZstdDecompressor().decompress(packed))
        if f"{tree['version']}{REFIT_SUFFIX}" != path.name:
            raise ValueError(f"it is {tree['version']} under another name")
        recipe = Recipe(tree["level"], tuple(tree["laws"]), tuple(tree["settings"]), tree["code"])
        made, problem = datetime.datetime.fromisoformat(tree["made_utc"]), tree["row"].get("problem") or ""
        stored = tree["results"]
        return Refit(
            tree["version"],
            recipe,
            made,
            problem,
            None if stored is None else decoded(stored, path).runs[0],
            tree.get("turn", 0),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zstandard.ZstdError) as error:
        raise unreadable(path, error, "refit") from None
