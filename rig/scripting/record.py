"""One record, read as arrays."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from acquisition.record.reader import RecordReader
from acquisition.record.topics import SWING, RecordedWindow
from processing.deflections import Deflections, DeflectionUnit


@dataclass(frozen=True)
class Record:
    """A record on disk. Every method opens the file, reads what it returns, and closes it.

    Attributes
    ----------
    unit
        Of deflections and amplitudes: rad, or px where the rig had no calibrated lever.
    metadata
        Texts by section and key: session, camera, environment, versions.
    truncated
        The file was cut short; what is there is read.
    """

    path: Path
    unit: DeflectionUnit
    metadata: Mapping[str, Mapping[str, str]]
    truncated: bool

    def spots(self) -> NDArray[Any]:
        """One row a frame: `sequence`, the times, the spot in px with its uncertainties and flags.

        A structured array; the names of its fields end in their units. NaN where the spot was lost.
        """
        with RecordReader(self.path) as reader:
            return reader.spots()

    def deflections(self) -> Deflections:
        """Deflections of the pendulum along both axes, in `unit`, with standard uncertainties."""
        with RecordReader(self.path) as reader:
            return reader.deflections()

    def swings(self) -> NDArray[Any]:
        """One row a half-cycle, as detected while the record was made (fits measure them again).

        A structured array; the names of its fields end in their units: `amplitude_rad`, or `amplitude_px`
        without a lever. `flags` is 0 for those that may be fitted (`processing.swing.SwingFlag`).
        """
        with RecordReader(self.path) as reader:
            return reader.table(SWING.topic)

    def events(self) -> NDArray[Any]:
        """What happened during the run: `time_ns`, `kind` and `text`, in a structured array."""
        with RecordReader(self.path) as reader:
            events = reader.events()
        kinds = np.array([str(event.kind) for event in events], dtype=np.str_)
        texts = np.array([event.text for event in events], dtype=np.str_)
        fields = np.dtype([("time_ns", np.int64), ("kind", kinds.dtype), ("text", texts.dtype)])
        table = np.empty(len(events), dtype=fields)
        table["time_ns"], table["kind"], table["text"] = [e.time_ns for e in events], kinds, texts
        return table

    def windows(self) -> Iterator[RecordedWindow]:
        """The pixels around the spot, frame by frame; memory stays flat."""
        with RecordReader(self.path) as reader:
            yield from reader.windows()

    def images(self) -> Iterator[Frame]:
        """The whole frames, of which there is one every few seconds."""
        with RecordReader(self.path) as reader:
            yield from reader.images()


def open_record(path: str | Path) -> Record:
    """A record (MCAP file).

    Raises
    ------
    RigError
        No such file, or no record of this program.
    """
    with RecordReader(Path(path)) as reader:
        return Record(reader.path, reader.deflection_unit, reader.metadata, reader.truncated)
