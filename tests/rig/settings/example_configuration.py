"""Makes configs/rig-example.toml from the models: ``python -m tests.rig.settings.example_configuration``.

A test compares the file with this output, so that no key is missing or obsolete.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo

from rig.settings import Configuration
from rig.settings.configuration_writer import EXAMPLE_NAME, commented_file
from rig.settings.validation_messages import section_fields, section_of

TARGET = Path(__file__).resolve().parents[3] / "configs" / "rig-example.toml"
HEAD = """\
# A real rig, every key: uncomment and change what you need; a key left out keeps the value shown.
# Values in angle brackets have no default. `extends = "other.toml"` at the top takes everything
# else from another file. On the command line: --set session.runs=3
# A key that is misspelt, out of range or of the wrong type is an error, never ignored.
"""
# Keys that are set instead of commented out, so that the file works as a starting point.
ACTIVE: dict[str, Any] = {
    "session.operator": "your name",
    "session.sample": "steel ball on K8 glass, cleaned with ethanol",
    "session.runs": 3,
    "camera.driver": "usb3vision",
    "camera.exposure_us": 100.0,
    "camera.frame_rate_hz": 100.0,
    "camera.pixel_format": "mono8",
    "sensor.gain_e_per_dn": 39.2,
    "sensor.read_noise_e": 7.0,
    "sensor.full_scale_dn": 255,
    "lever.arm_m": 1.0,
    "lever.u_arm_m": 0.001,
    "lever.pixel_pitch_m": 4.8e-6,
    "lever.u_pixel_pitch_m": 1e-9,
    "pendulum.mass_kg": 0.406,
    "pendulum.u_mass_kg": 0.0001,
    "pendulum.ball_radius_m": 6.05e-3,
    "pendulum.u_ball_radius_m": 1e-6,
    "pendulum.ball_material": EXAMPLE_NAME,
    "pendulum.flat_material": "glass_k8",
    "pendulum.u_gravity_m_per_s2": 1e-4,
    f"materials.{EXAMPLE_NAME}.youngs_modulus_pa": 2.11e11,
    f"materials.{EXAMPLE_NAME}.poisson_ratio": 0.28,
    f"materials.{EXAMPLE_NAME}.u_youngs_modulus_pa": 3e9,
    f"materials.{EXAMPLE_NAME}.u_poisson_ratio": 0.01,
}


def text() -> str:
    """The whole file."""
    return HEAD + commented_file(ACTIVE)


def keys(path: str = "", model: type = Configuration) -> Iterator[str]:
    """Dotted paths of all keys, materials under an example's name."""
    for name, field in section_fields(model).items():
        inner = section_of(field)
        place = f"{path}{name}"
        if inner is None:
            yield place
        else:
            yield from keys(f"{place}.{EXAMPLE_NAME}." if _is_table_of(field) else f"{place}.", inner)


def _is_table_of(field: FieldInfo) -> bool:
    return str(field.annotation).startswith("dict")


if __name__ == "__main__":
    TARGET.write_text(text(), encoding="utf-8")
    print(TARGET)
