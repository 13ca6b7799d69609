"""The columns of the archive, one row a run, as SQL types; docs/reference/archive.md says what they mean."""

from collections.abc import Iterable, Mapping
from typing import Final

from processing.derived import Derived
from processing.quantity import quantities_of

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


def _typed(text: str) -> dict[str, str]:
    words = text.replace(",", " ").split()
    return dict(zip(words[::2], words[1::2], strict=True))


def _estimated(names: Iterable[str]) -> dict[str, str]:
    return {column: "double" for name in names for column in (name, f"u_{name}")}


def of_row(name: str) -> tuple[str, ...]:
    """The columns of a row of the table of results: value, u, u_total, and both ends of the interval."""
    return (name, f"u_{name}", f"u_total_{name}", f"lower_{name}", f"upper_{name}")


COLUMNS: Final[Mapping[str, str]] = {
    **_typed("""
        sha256 varchar, session varchar, run varchar, folder varchar, record varchar, record_bytes bigint,
        state varchar, flaw varchar, windows varchar, results varchar, results_sha256 varchar,
        added_utc timestamp, began_utc timestamp, duration_s double,
        sample varchar, operator varchar, contact_history varchar, noted varchar, host varchar,
        temperature_c double, humidity_percent double, pressure_pa double, dwell_s double, age_s double,
        camera varchar, camera_serial varchar, code_version varchar, code_commit varchar,
        configuration_sha256 varchar, frames bigint, dropped_frames bigint, half_cycles bigint,
        amplitude_unit varchar, initial_amplitude double, final_amplitude double,
        conditions_met boolean, problem varchar, law varchar
    """),
    **{column: "double" for name in PARAMETERS for column in of_row(name)},
    **{f"verdict_{name}": "varchar" for name in PARAMETERS},
    **_typed("witness varchar, witness_explained double, chi2_per_dof double, degrees_of_freedom bigint"),
    **_estimated(("mean_period_s",)),
    **{column: "double" for name in DERIVED for column in of_row(name)},
    **{f"verdict_{name}": "varchar" for name in DERIVED},
    **_typed("mass_kg double, ball_radius_m double, instrument varchar"),
    **_estimated(OF_INSTRUMENTS),
}
SHORT_NAMES: Final[Mapping[str, str]] = {"temperature": "temperature_c", "humidity": "humidity_percent"}
"""Further names in conditions."""
IMPORTANT: Final = ("run", "sample", "began_utc", "b", "c", "state")
"""What `list` shows where there is no room for all of `SHOWN`."""
SHOWN: Final = (*IMPORTANT[:3], "humidity_percent", "temperature_c", "b", "p", "c", "n", "state")
IS_SIMULATED: Final = "coalesce(camera = 'simulated rig', false)"
"""Whether the numbers of a run were invented, in SQL."""
