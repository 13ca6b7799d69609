"""What is known of a whole run, for the table in which Rerun's catalogue lists a folder of .rrd files."""

from collections.abc import Iterator
from math import isfinite

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from processing.fit import FitMethod
from rig.analysis import recorded_results, recorded_surroundings

_OF_SESSION = ("sample", "operator", "contact_history", "host")


def run_properties(reader: RecordReader) -> dict[str, float | str]:
    """Sample, rig and air of a record, and the exact fit of the results beside it, if any, by name.

    Names end in their units; `u_NAME` is a standard uncertainty. What is not known is left out.
    """
    air = recorded_surroundings(reader).known()
    found: dict[str, float | str] = dict([*_stated(reader), *air.items(), *_fit(reader)])
    return {name: value for name, value in found.items() if isinstance(value, str) or isfinite(value)}


def _stated(reader: RecordReader) -> Iterator[tuple[str, str]]:
    session, camera = (reader.metadata.get(name, {}) for name in ("session", "camera"))
    yield from ((name, session[name]) for name in _OF_SESSION if session.get(name))
    for name, key in (("camera", "model"), ("camera_serial", "serial")):
        if camera.get(key):
            yield name, camera[key]


def _fit(reader: RecordReader) -> Iterator[tuple[str, float | str]]:
    if not any(reader.path.parent.glob("results*.json")):
        return
    _, results = recorded_results(reader.path, sha256_of(reader.path))
    fit = None if results is None else results.fits.get(FitMethod.EXACT)
    if fit is not None:
        yield "law", fit.law
        for name, estimate in fit.parameters.items():
            yield name, estimate.value
            yield f"u_{name}", estimate.standard_uncertainty
