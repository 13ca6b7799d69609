"""Configuration: reads a TOML file and command-line overrides into frozen, validated models."""

from rig.settings.configuration import (
    Configuration,
    FitSettings,
    PendulumSettings,
    ReferenceSettings,
    SessionSettings,
)
from rig.settings.configuration_file import (
    ALL,
    FITTED,
    REPLAYED,
    SCHEMA,
    SCHEMA_KEY,
    apply_overrides,
    key_faults,
    load_configuration,
    read_toml,
    refuse_without_effect,
    shipped,
    shipped_names,
    stored_configuration,
    validate_configuration,
    without_schema,
)
from rig.settings.configuration_writer import copy_shipped, refuse_existing, write_configuration
from rig.settings.number_input import StopCondition, read_quantity
from rig.settings.sections import BalanceSettings, InstrumentSettings, PreflightSettings, TimebaseSettings
from rig.settings.validation_messages import fault_line, validate
