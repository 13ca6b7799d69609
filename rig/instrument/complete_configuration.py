"""A configuration with every section filled that can be: by calibration files or the simulated rig."""

from rig.instrument.calibration import fill_from_files
from rig.instrument.simulated_rig import fill_from_truth
from rig.settings import Configuration


def complete(config: Configuration) -> Configuration:
    """Fill the sections that are not stated: from calibration files, and from a simulated rig's truth."""
    config = fill_from_files(config)
    return fill_from_truth(config) if config.simulated else config
