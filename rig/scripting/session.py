"""Records and sessions for scripts."""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from acquisition.record.reader import RecordReader
from acquisition.record.topics import BALANCE, HALF_CYCLE, RecordedWindow
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError
from rig.analysis import ResultRow, SessionResults, read_results
from rig.report import draw_run, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def as_list(value: Any, *single: type) -> list[Any]:
    """A path or value of the `single` types, or a sequence of these, as a list; an empty one is refused."""
    values = [value] if isinstance(value, (str, os.PathLike, *single)) else list(value)
    if not values:
        raise ConfigurationError("nothing is named; name at least one record or session")
    return values


def setting_texts(changes: Mapping[str, object] | None) -> list[str]:
    """Changes of a configuration as ``KEY=VALUE`` of the command line; NumPy's numbers become Python's."""
    return [
        f"{key}={json.dumps(value.item() if isinstance(value, np.generic) else value)}"
        for key, value in (changes or {}).items()
    ]


@dataclass(frozen=True, repr=False)
class Record:
    """A record on disk. Every method opens the file, reads the data that it returns, and closes the file.

    Attributes
    ----------
    path
        The file.
    unit
        Unit of deflections and amplitudes: rad, or px if the rig had no calibrated lever.
    metadata
        Texts by section and key: session, camera, environment, versions.
    truncated
        Whether the file was cut short; its complete part is read.
    """

    path: Path
    unit: DeflectionUnit
    metadata: Mapping[str, Mapping[str, str]]
    truncated: bool

    def spots(self) -> NDArray[Any]:
        """Spots as a structured array (n,), one row per frame.

        The fields are the frame number, the times, position and shape of the spot with standard
        uncertainties, flags, and the deflections. Their names end in the unit. NaN where the spot was lost.
        """
        with RecordReader(self.path) as reader:
            return reader.spots()

    def deflections(self) -> Deflections:
        """Deflections of the pendulum along both axes, arrays (n,) in `unit`, with standard uncertainties.

        x is the fast mode, y the slow mode; NaN where the spot was lost.
        """
        with RecordReader(self.path) as reader:
            return reader.deflections()

    def half_cycles(self) -> NDArray[Any]:
        """Half-cycles as a structured array (n,), one row each, as they were detected during the run.

        The names of the fields end in the unit: `amplitude_rad`, or `amplitude_px` without a lever. `flags`
        is 0 for half-cycles that are fitted (see `processing.swing.HalfCycleFlag`). Fits determine the
        turning points again.
        """
        with RecordReader(self.path) as reader:
            return reader.table(HALF_CYCLE.topic)

    def balance(self) -> NDArray[Any]:
        """States of the balance as a structured array (n,), one row each, as determined during the run.

        The names of the fields end in their unit: `rest_y_rad` (`rest_y_px` without a lever). Those without a
        unit have none: `period_ratio`. Each quantity has its standard uncertainty, `u_...`.
        """
        with RecordReader(self.path) as reader:
            return reader.table(BALANCE.topic)

    def __repr__(self) -> str:
        sample = self.metadata.get("session", {}).get("sample", "")
        cut = ", cut short" if self.truncated else ""
        return f"<record {self.path}: {sample or 'no sample stated'}, in {self.unit}{cut}>"

    def events(self) -> NDArray[Any]:
        """Events during the run as a structured array (n,): `time_ns`, `kind` and `text`."""
        with RecordReader(self.path) as reader:
            events = reader.events()
        kinds = np.array([str(event.kind) for event in events], dtype=np.str_)
        texts = np.array([event.text for event in events], dtype=np.str_)
        fields = np.dtype([("time_ns", np.int64), ("kind", kinds.dtype), ("text", texts.dtype)])
        table = np.empty(len(events), dtype=fields)
        table["time_ns"], table["kind"], table["text"] = [event.time_ns for event in events], kinds, texts
        return table

    def windows(self) -> Iterator[RecordedWindow]:
        """Windows of raw pixels around the spot, one frame at a time, for records larger than memory."""
        with RecordReader(self.path) as reader:
            yield from reader.windows()

    def images(self) -> Iterator[Frame]:
        """Whole frames, which are recorded every few seconds, one at a time."""
        with RecordReader(self.path) as reader:
            yield from reader.images()


def open_record(path: str | Path) -> Record:
    """Open a record (MCAP file).

    Raises
    ------
    RigError
        The file does not exist, or is not a record of this program.
    """
    with RecordReader(Path(path)) as reader:
        return Record(reader.path, reader.deflection_unit, reader.metadata, reader.truncated)


def figures(source: "str | Path | Session | SessionResults", run: int = 1) -> "Mapping[str, Figure]":
    """Figures of one run of a session, by the names that their files have in a report.

    Parameters
    ----------
    source
        Folder of a session, a results file, a session, or results such as `rig.fit` returns.
    run
        Number of the run, counted from 1.

    Returns
    -------
    Mapping of str to matplotlib.figure.Figure
        A notebook displays the figures; `savefig` writes them.

    Raises
    ------
    RigError
        There are no results or no such run, or a record is missing.
    """
    if isinstance(source, SessionResults) and source.trajectory:
        raise ConfigurationError(
            "source: figures of a table need its positions: rig fit TABLE -o FOLDER, then rig.figures(FOLDER)"
        )
    if isinstance(source, Session):
        source = source.folder
    results = source if isinstance(source, SessionResults) else Path(source)
    with styled():
        return {drawing.name: drawing.figure for drawing in draw_run(results, run)}


@dataclass(frozen=True, repr=False)
class Session:
    """A session: its folder, its results, and the records from which they were made, in order of the runs.

    ``session["b"]`` is a row of its table of results: of its series, or of its one run.
    """

    folder: Path
    results: SessionResults
    records: tuple[Record, ...]

    def __getitem__(self, name: str) -> ResultRow:
        return self.results[name]

    def __repr__(self) -> str:
        return f"session {self.folder}\n{self.results!r}"

    def figures(self, run: int = 1) -> "Mapping[str, Figure]":
        """Figures of one run, counted from 1; see `rig.figures`."""
        return figures(self.folder, run)


def open_session(folder: str | Path) -> Session:
    """Open the folder of a session with its results.json.

    Raises
    ------
    RigError
        There are no results (`rig.fit` makes them), or a record is missing.
    """
    folder = Path(folder)
    results = read_results(folder)
    return Session(folder, results, tuple(open_record(folder / run.record) for run in results.runs))
