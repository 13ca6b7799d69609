"""The wizard of the air's drag: which vanes to cut, then one run after the other."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rig.calibrate import Filing, VanesToCut, calibrate_air
from rig.settings import number, optional
from rig.wizards.calibration import a_record, write_table
from rig.wizards.question import Choice, Question, RecordedAnswer

_FEWEST_RUNS, _SECONDS = 6, 1500.0
_UNITS = {
    "vanes": ("area_m2", "m2", "Area of the vanes in m2, one face of each (0.013; 0 without)"),
    "pressures": ("pressure_pa", "Pa", "Pressure in Pa (101325)"),
}
_IN_GENERAL = (
    "Cut thin stiff sheets in pairs, one of each pair for either end of the pendulum, upright, so that they "
    "move in their own plane; with --config the size is computed. In runs without them, put the same weight "
    "in compact pieces at the same places, so that the load on the ball does not change."
)
_DO = (
    " Make two runs without vanes, two with the smaller and two with the larger ones, in turn, from one "
    "start, without lifting the ball off its place."
)


def air_questions(values: Mapping[str, Any], vanes: VanesToCut | None = None) -> Iterator[Question]:
    """What changes the air's drag, then exposure and record of each run; `vanes` is for this pendulum."""
    yield Question(
        "way",
        "What changes the drag:",
        str,
        suggested="vanes",
        choices=(
            Choice("vanes", "vanes on the pendulum"),
            Choice("pressures", "the pressure in a chamber around it"),
        ),
    )
    key, unit, what = _UNITS[values["way"]]
    do = "Make runs at three pressures, two each, one of them the room's."
    if key == "area_m2":
        do = (_IN_GENERAL if vanes is None else vanes.text) + _DO
    count = 0
    while True:
        count += 1
        done = count > _FEWEST_RUNS
        read = number(unit, least=0.0)
        yield Question(
            f"exposure {count}",
            f"Run {count}: {what}{' (Enter: no further run)' if done else ''}:",
            optional(read) if done else read,
            do=do if count == 1 else "",
            suggested="" if done else None,
            says_enter=done,
        )
        if values[f"exposure {count}"] is None:
            break
        yield Question(
            f"record {count}",
            "Its record:",
            a_record,
            do="Start the swing and record its whole decay.",
            recording=RecordedAnswer("record", f"air-run-{count}", seconds=_SECONDS),
        )


def file_air(values: Mapping[str, Any], filing: Filing) -> Path:
    """See `CalibrationWizard`."""
    return calibrate_air(write_table(filing.folder, "air-vanes", air_table(values)), filing)


def air_table(values: Mapping[str, Any]) -> dict[str, Any]:
    """What the answers state, as the file has it."""
    key = _UNITS[values["way"]][0]
    runs: list[dict[str, Any]] = []
    while values.get(f"exposure {len(runs) + 1}") is not None:
        number_of_run = len(runs) + 1
        runs.append({"record": values[f"record {number_of_run}"], key: values[f"exposure {number_of_run}"]})
    return {"run": runs}
