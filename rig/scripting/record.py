"""One record, read as arrays."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from acquisition.record.reader import RecordReader
from acquisition.record.topics import BALANCE, SWING, RecordedWindow
from processing.deflections import Deflections, DeflectionUnit
from rig.scripting.given import path_of


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

    def swings(self) -> NDArray[Any]:
        """Half-cycles as a structured array (n,), one row each, as they were detected during the run.

        The names of the fields end in the unit: `amplitude_rad`, or `amplitude_px` without a lever. `flags`
        is 0 for half-cycles that are fitted (see `processing.swing.SwingFlag`). Fits determine the turning
        points again.
        """
        with RecordReader(self.path) as reader:
            return reader.table(SWING.topic)

    def balance(self) -> NDArray[Any]:
        """States of the balance as a structured array (n,), one row each, as they were found during the run.

        The names of the fields end in the unit, where they have one: `rest_y_rad` (`rest_y_px` without a
        lever), `period_ratio` ..., each with its `u_`.
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
        table["time_ns"], table["kind"], table["text"] = [e.time_ns for e in events], kinds, texts
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
    with RecordReader(path_of(path, "path")) as reader:
        return Record(reader.path, reader.deflection_unit, reader.metadata, reader.truncated)
