"""Refuses a changed key that a command does not use, before it calculates something else than was asked."""

from collections.abc import Iterable, Sequence

from processing.errors import ConfigurationError

OF_FITS = (
    "axes.u_",
    "environment",
    "fit",
    "instrument",
    "lever.arm_dof",
    "lever.pixel_pitch_dof",
    "lever.u_",
    "materials",
    "pendulum",
    "preflight",
    "timebase",
)
"""What the fits of a record take from its configuration: keys, or how they begin."""
OF_TABLES = (
    *OF_FITS,
    "axes",
    "calibration.axes",
    "calibration.clock",
    "calibration.lever",
    "calibration.shutter",
    "lever",
    "shutter",
)
OF_REPLAYS = (*OF_FITS, "axes", "lever", "shutter", "view")
OF_TRACKING = (*OF_REPLAYS, "sensor")


def refuse_without_effect(overrides: Iterable[str], used: Sequence[str], remedy: str) -> None:
    """Raise ConfigurationError with a line for each of ``KEY=VALUE`` that is not among the `used` keys."""
    keys = (override.partition("=")[0].strip() for override in overrides)
    lines = [f"--set {key}: has no effect here; {remedy}" for key in keys if not _begins(key, used)]
    if lines:
        raise ConfigurationError("\n".join(lines))


def _begins(key: str, used: Sequence[str]) -> bool:
    return any(key == name or key.startswith(name if name.endswith("_") else f"{name}.") for name in used)
