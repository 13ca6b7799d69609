"""The errors that a person may meet, one short tree.

A message names the thing, the value received and what to do. Modules raise the most
specific class; the command line turns any `RigError` into one line and an exit status.
"""


class RigError(Exception):
    """Base of every error that is meant to be read by the user."""


class ConfigurationError(RigError):
    """A setting is unknown, missing, of the wrong unit or out of range (exit status 2)."""


class DeviceError(RigError):
    """A camera, controller, laser or sensor is missing, refuses or has gone."""


class RecordError(RigError):
    """A record cannot be written, or what was read is no record of ours."""


class DataError(RigError):
    """The data cannot carry what was asked of them (too few swings, no spot, no decay)."""
