"""Configuration: reads a TOML file and command-line overrides into frozen, validated models."""

from rig.settings.balance import BalanceSettings
from rig.settings.calibration import TimebaseSettings
from rig.settings.configuration import (
    Configuration,
    FitSettings,
    PendulumSettings,
    SessionSettings,
    apply_overrides,
    load_configuration,
    validate_configuration,
)
from rig.settings.instrument import InstrumentSettings
from rig.settings.night_plan import PlannedSeries, load_plan
from rig.settings.phases import PreflightSettings
from rig.settings.stop_conditions import StopCondition

__all__ = [
    "BalanceSettings",
    "Configuration",
    "FitSettings",
    "InstrumentSettings",
    "PendulumSettings",
    "PlannedSeries",
    "PreflightSettings",
    "SessionSettings",
    "StopCondition",
    "TimebaseSettings",
    "apply_overrides",
    "load_configuration",
    "load_plan",
    "validate_configuration",
]
