"""Fills missing sections of a configuration from calibration files or from the simulated rig."""

from rig.instrument.calibration import fill_from_files
from rig.instrument.simulated_rig import fill_from_truth
from rig.settings import Configuration


def complete(config: Configuration) -> Configuration:
    """Fill missing sections from calibration files and from the true values of a simulated rig."""
    config = fill_from_files(config)
    return fill_from_truth(config) if config.simulated else config
