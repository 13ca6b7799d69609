"""Every key of the configuration has an effect: a change has consequences, or the program reads the key.

Sections that become plain values (`stated_values`) are held to the first: each key is changed, and
what is made of the configuration must change too. The others decide how hardware, threads and
screens behave: parts of the program are set to work with them (`program_at_work`), and each key must
be read there, by more than the code that checks and copies a configuration. A camera driver needs
its camera for that; its keys must be named in the driver's source.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

import pytest
from pydantic import BaseModel, create_model

import acquisition.cameras
from calibration.axes_fit import Axes
from calibration.light_lever import Lever
from rig.instrument import complete
from rig.settings import Configuration
from rig.settings.configuration import RecordSettings
from rig.settings.validation_messages import section_fields, section_of
from tests.rig.settings import program_at_work as program
from tests.rig.settings import stated_values as stated
from tests.rig.settings.example_configuration import _is_table_of
from tests.rig.settings.key_readers import Key, is_read, keys_read

ROOT = Path(__file__).parents[3]
FILES = ("toml", "mcap", "json", "jsonl", "py", "md", "html")
DEVICE_KEYS = ("kind", "port", "driver", "when")
OBSERVED: dict[str, Callable[[Configuration], Any]] = {
    "environment": stated.metadata,
    "session.operator": stated.metadata,
    "session.sample": stated.metadata,
    "session.notes": stated.metadata,
    "session.contact_history": stated.metadata,
    "session.contact_made": stated.metadata,
    "session.surfaces_cleaned": stated.metadata,
    "sensor": stated.optical_path,
    "shutter": stated.shutter,
    "lever": stated.calibrated,
    "axes": stated.calibrated,
    "timebase": stated.calibrated,
    "pendulum": stated.apparatus,
    "pendulum.u_contact_radius_m": stated.stated_contact,
    "materials": stated.apparatus,
    "balance": stated.balance,
    "instrument": stated.instrument,
    "fit.drag_s": stated.apparatus,
    "fit.u_drag_s": stated.apparatus,
}
"""Sections and keys whose change must show."""

READ_ONLY = {"balance.seconds"}
"""Keys of those sections that decide how long something takes."""

STATED: dict[str, Any] = {
    "axes": {"slow_angle_rad": 0.1, "non_orthogonality_rad": 0.05},
    "lever": {
        "arm_m": 1.0,
        "arm_dof": 12.0,
        "pixel_pitch_m": 4.8e-6,
        "pixel_pitch_dof": 12.0,
        "skew": 0.1,
        "reference_x_px": 70.0,
        "reference_y_px": 300.0,
    },
    "sensor": {"gain_e_per_dn": 39.0, "read_noise_e": 7.0, "full_scale_dn": 255.0},
    "shutter": {"row_time_s": 1e-5, "u_row_time_s": 1e-7, "first_row": "top"},
    "timebase": {},
    "environment": {"temperature_c": 20.0, "humidity_percent": 40.0, "pressure_pa": 1e5},
    "pendulum": {
        "mass_kg": 0.4,
        "ball_radius_m": 6e-3,
        "ball_material": "mine",
        "flat_material": "glass_k8",
        "length_m": 0.5,
        "width_m": 0.05,
    },
    "materials": {"mine": {"youngs_modulus_pa": 2e11, "poisson_ratio": 0.3}},
    "balance": {"inertia_kg_m2": 0.01, "gamma_pa": 1e7},
    "fit": {"drag_s": 1e-3, "u_drag_s": 2e-4},
    "instrument": {
        "mass_kg": 0.2,
        "support_radius_m": 2.5e-3,
        "lever_m": 0.05,
        "start_amplitude_deg": 6.0,
        "end_amplitude_deg": 3.0,
        "period_s": 1.4,
        "period_tolerance_s": 0.02,
        "glass_time_s": 250.0,
        "glass_tolerance_s": 10.0,
        "temperature_c": 23.0,
        "temperature_tolerance_c": 2.0,
        "humidity_percent": 50.0,
        "humidity_tolerance_percent": 5.0,
        "reference_runs": (1,),
        "reference_time_s": 200.0,
    },
}
"""A configuration in which every one of those keys matters."""

OTHER: dict[str, Any] = {
    "session.contact_made": "2026-11-22T09:30:00+01:00",
    "session.surfaces_cleaned": "2026-11-22T09:30:00+01:00",
    "pendulum.ball_material": "steel",
    "pendulum.flat_material": "steel",
    "pendulum.contact_radius_m": 1e-4,
    "instrument.kind": "persoz",
    "sensor.hot_pixels_xy": ((3, 4),),
    "shutter.first_row": "bottom",
    "shutter.u_row_time_s": 3e-7,
    "instrument.reference_runs": (2,),
}
"""Changed values that do not follow from the present one."""


def leaves(path: str = "", model: type = Configuration) -> Iterator[tuple[str, Key]]:
    """Every key by its dotted path, with the model that has it; materials under the name `mine`."""
    for name, field in section_fields(model).items():
        inner = section_of(field)
        if inner is None:
            yield f"{path}{name}", (model, name)
        else:
            yield from leaves(f"{path}{name}.{'mine.' if _is_table_of(field) else ''}", inner)


def observer(key: str) -> Callable[[Configuration], Any] | None:
    return None if key in READ_ONLY else OBSERVED.get(key) or OBSERVED.get(key.partition(".")[0])


def changed(key: str, value: Any) -> Any:
    """Another value that is allowed for a key."""
    if key in OTHER:
        return OTHER[key]
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return f"{value} changed"
    if isinstance(value, int):
        return -value if key.endswith("sense") else value + 1
    assert isinstance(value, float), f"{key}: state a value in STATED or another in OTHER"
    return 1.01 * value if value else 1e-3


def with_value(tree: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    first, _, rest = key.partition(".")
    return {**tree, first: with_value(tree[first], rest, value) if rest else value}


def stated_configuration(tree: dict[str, Any] = STATED) -> Configuration:
    return complete(Configuration.model_validate({"camera": {"driver": "files"}, **tree}))


@cache
def stated_tree() -> dict[str, Any]:
    """All of its keys, with the values that complete it; nobody changes it."""
    return stated_configuration().model_dump()


def value_of(config: Any, key: str) -> Any:
    for part in key.split("."):
        config = config[part] if isinstance(config, dict) else getattr(config, part)
    return config


CHANGED = [key for key, _ in leaves() if observer(key) is not None]


@cache
def observed_before(observe: Callable[[Configuration], Any]) -> Any:
    return observe(stated_configuration())


@pytest.mark.slow
@pytest.mark.parametrize("key", CHANGED)
def test_a_changed_key_changes_what_is_made_of_it(key: str) -> None:
    observe = observer(key)
    assert observe is not None
    before = stated_tree()
    after = with_value(before, key, changed(key, value_of(before, key)))
    assert observe(stated_configuration(after)) != observed_before(observe)


@pytest.mark.parametrize("observe", list(dict.fromkeys(OBSERVED.values())))
def test_nothing_changes_by_itself(observe: Callable[[Configuration], Any]) -> None:
    assert observe(stated_configuration(stated_tree())) == observed_before(observe)


@cache
def _driver_names(driver: str) -> set[str]:
    """Attributes that are read in a camera driver's source, or by the settings of all drivers themselves."""
    folder = Path(acquisition.cameras.__file__).parent
    files = [*(folder / driver).rglob("*.py"), *folder.glob(f"{driver}.py"), folder / "drivers.py"]
    trees = (ast.parse(file.read_text(encoding="utf-8")) for file in files)
    return {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> set[Key]:
    """The keys that the program reads at work."""
    folder = tmp_path_factory.mktemp("work")
    with keys_read() as found, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        program.measure_one_session(folder)
        program.go_through_the_phases(folder)
        program.look_at_the_balance()
        program.talk_to_the_controller()
        program.pulse_the_laser()
        program.read_the_environment()
        program.choose_a_camera()
        program.suffer_every_fault()
        program.shake_the_ground(folder)
        program.listen_to_the_ground()
        program.see_a_reference(folder)
        if sys.platform != "win32":
            program.light_the_lasers()
    return found


@pytest.mark.slow
def test_every_other_key_is_read(seen: set[Key]) -> None:
    unread = []
    for key, owner in leaves():
        parts = key.split(".")
        if observer(key) is not None:
            continue
        if parts[0] == "camera" and len(parts) == 3:
            if parts[2] not in _driver_names(parts[1]):
                unread.append(key)
        elif not is_read(owner, seen):
            unread.append(key)
    assert not unread


def test_a_key_that_nobody_reads_is_found(tmp_path: Path) -> None:
    """Validated, copied and written down with the others, and read by nobody: it is not taken for read."""
    planted = create_model("RecordSettings", __base__=RecordSettings, planted=(int, 3))
    with keys_read() as found:
        config = Configuration.model_construct(**{**dict(stated_configuration()), "record": planted()})
        config.model_dump_json()
        config.model_copy(deep=True)
        stated.optical_path(config)
        assert config.record.windows
    assert is_read((RecordSettings, "windows"), found)
    assert not is_read((planted, "planted"), found)
    with keys_read() as found:
        assert value_of(config, "record.planted") == 3
    assert is_read((planted, "planted"), found)


@pytest.mark.parametrize("model", [Axes, Lever])
def test_a_planted_key_changes_nothing(model: type[BaseModel]) -> None:
    """The same for the keys whose change must show."""
    planted: Any = create_model(model.__name__, __base__=model, planted=(float, 1.0))
    name = model.__name__.lower()
    before, after = (
        stated_configuration().model_copy(update={name: planted(**STATED[name], planted=value)})
        for value in (1.0, 2.0)
    )
    assert OBSERVED[name](after) == OBSERVED[name](before)


NO_KEYS = ("rig/report/drawing.py",)
"""Files whose dotted words are those of another program."""


def test_keys_that_messages_name_exist() -> None:
    """A remedy named `environment.kind`, which is a key of no section."""
    wrong = []
    for package in ("rig", "acquisition", "calibration", "processing"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if name not in NO_KEYS:
                # compiled already, as a rule
                code = SourceFileLoader(name, str(path)).get_code(name)
                wrong += [f"{name}: {key}" for text in texts_of(code) for key in wrong_keys(text)]
    assert wrong == []


def texts_of(constant: object) -> Iterator[str]:
    """The strings of a constant of compiled code, which may be code or a collection."""
    if isinstance(constant, str):
        yield constant
    elif isinstance(constant, CodeType | tuple | frozenset):
        for one in constant.co_consts if isinstance(constant, CodeType) else constant:
            yield from texts_of(one)


def wrong_keys(text: str) -> list[str]:
    """Words of a text that look like a key of the configuration, and are none."""
    sections = known_sections()
    return [
        f"{section}.{key}"
        for section, key in re.findall(r"(?<![\w./-])([a-z_]+)\.([a-z_0-9]+)(?![\w/(])", text)
        if key not in FILES and (key not in sections[section] if section in sections else key in DEVICE_KEYS)
    ]


@cache
def known_sections() -> dict[str, set[str]]:
    """The keys of each section."""
    models = {name: section_of(field) for name, field in section_fields(Configuration).items()}
    assert None not in models.values(), "a key that is in no section"
    return {name: set(section_fields(model)) for name, model in models.items() if model is not None}
