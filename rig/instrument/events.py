"""What happens to a measurement beside its frames."""

from typing import NamedTuple


class Event(NamedTuple):
    """Something that happened to the measurement, as it goes into the record."""

    time_ns: int
    kind: str
    text: str
