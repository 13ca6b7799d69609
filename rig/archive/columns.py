"""The columns of the catalogue, one row a run. What stands here stands in docs/reference/archive.md."""

from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

from processing.derived import Derived
from processing.quantity import quantities_of

Kind = Literal["text", "number", "count", "yes or no", "time"]
SQL_TYPES: Final[Mapping[Kind, str]] = {
    "text": "varchar",
    "number": "double",
    "count": "bigint",
    "yes or no": "boolean",
    "time": "timestamp",
}

PARAMETERS: Final = ("b", "p", "c", "n", "period0_s", "gamma_pa", "drag_s")
"""Of the contact's laws, as far as results hold them."""

DERIVED: Final = quantities_of(Derived)
"""What follows from them."""

OF_INSTRUMENTS: Final = (
    "scale_hardness",
    "time_hardness_s",
    "time_hardness_first_swing_s",
    "log_decrement",
    "rolling_friction_coefficient",
)
"""Of other kinds of pendulum: names of `InstrumentResults` that hold a value with its uncertainty."""


class Column(NamedTuple):
    """What a column holds; its name ends in its unit."""

    kind: Kind
    meaning: str


def _estimated(name: str, meaning: str) -> dict[str, Column]:
    return {name: Column("number", meaning), f"u_{name}": Column("number", f"standard uncertainty of {name}")}


COLUMNS: Final[Mapping[str, Column]] = {
    "sha256": Column("text", "of the record; it identifies the run, and its first characters suffice"),
    "session": Column("text", "SHA-256 of the SHA-256 of all its records; its first characters suffice"),
    "run": Column("text", "name of the record without its ending"),
    "folder": Column("text", "the session's folder"),
    "record": Column("text", "path of the record, relative to the folder if inside it"),
    "record_bytes": Column("count", "size of the record"),
    "state": Column("text", "of the record: whole, cut short, cut, damaged, unreadable, missing"),
    "flaw": Column("text", "what is wrong with the record, in one line"),
    "windows": Column("text", "of raw pixels: recorded, none"),
    "results": Column("text", "name of the results file"),
    "results_sha256": Column("text", "its hash"),
    "added_utc": Column("time", "when the session was last read"),
    "began_utc": Column("time", "first message of the record"),
    "duration_s": Column("number", "from the first message to the last"),
    "sample": Column("text", "as configured"),
    "operator": Column("text", "as configured"),
    "contact_history": Column("text", "as configured"),
    "noted": Column("text", "operators' notes during the run"),
    "host": Column("text", "the computer that measured"),
    "temperature_c": Column("number", "mean sensor reading, otherwise as stated"),
    "humidity_percent": Column("number", "mean sensor reading, otherwise as stated"),
    "pressure_pa": Column("number", "mean sensor reading, otherwise as stated"),
    "dwell_s": Column("number", "from session.contact_made to the first frame"),
    "age_s": Column("number", "from session.surfaces_cleaned to the first frame"),
    "camera": Column("text", "model"),
    "camera_serial": Column("text", "serial number"),
    "code_version": Column("text", "of the program that measured"),
    "code_commit": Column("text", "of the program that measured"),
    "configuration_sha256": Column("text", "of the configuration that the results were made with"),
    "frames": Column("count", "with a spot or without"),
    "dropped_frames": Column("count", "that never arrived"),
    "half_cycles": Column("count", "found"),
    "amplitude_unit": Column("text", "of the next two: arcsec, or px without a lever"),
    "initial_amplitude": Column("number", "of the first half-cycle"),
    "final_amplitude": Column("number", "of the last"),
    "conditions_met": Column(
        "yes or no", "whether light, losses, temperature and the other conditions were met"
    ),
    "problem": Column("text", "why a fit is missing"),
    "law": Column("text", "that was fitted"),
    **{key: item for name in PARAMETERS for key, item in _estimated(name, "of the exact fit").items()},
    **{f"verdict_{name}": Column("text", f"whether the data determine {name}") for name in PARAMETERS[:-1]},
    **{
        f"u_total_{name}": Column("number", f"of {name} with all sources of the budget")
        for name in PARAMETERS[:-1]
    },
    "witness": Column("text", "of the ground: used, or why it was refused; empty without one"),
    "witness_explained": Column("number", "share of the drive that the witness explains"),
    "chi2_per_dof": Column("number", "of the exact fit"),
    "degrees_of_freedom": Column("count", "of the exact fit"),
    **_estimated("mean_period_s", "over the fitted half-cycles"),
    **{key: item for name, one in DERIVED.items() for key, item in _estimated(name, one.meaning).items()},
    "mass_kg": Column("number", "of the pendulum"),
    "ball_radius_m": Column("number", "of the ball"),
    "instrument": Column("text", "kind of pendulum, if not that of the contact's laws"),
    **{key: item for name in OF_INSTRUMENTS for key, item in _estimated(name, "as reported").items()},
}

SHORT_NAMES: Final[Mapping[str, str]] = {"temperature": "temperature_c", "humidity": "humidity_percent"}
"""Further names in conditions."""

SHOWN: Final = (
    "run",
    "sample",
    "began_utc",
    "humidity_percent",
    "temperature_c",
    "b",
    "p",
    "c",
    "n",
    "state",
)
"""What `list` shows by default."""
IMPORTANT: Final = ("run", "sample", "began_utc", "b", "c", "state")
"""What it shows where there is no room for all."""
IS_SIMULATED: Final = "coalesce(camera = 'simulated rig', false)"
"""Whether the numbers of a run were invented, in SQL."""
