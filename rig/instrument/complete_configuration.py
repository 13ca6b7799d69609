"""Fills missing sections of a configuration from calibration files or from the simulated rig."""

from rig.instrument.calibration import fill_from_files
from rig.instrument.simulated_rig import fill_from_truth
from rig.settings import Configuration


def complete(config: Configuration) -> Configuration:
    """Fill missing sections from calibration files and from the true values of a simulated rig.

    The lever becomes that of the camera's binning and colour plane.
    """
    config = fill_from_files(_binned(config))
    return _binned(fill_from_truth(config)) if config.simulated else config


def _binned(config: Configuration) -> Configuration:
    if config.lever is None:
        return config
    return config.model_copy(update={"lever": config.lever.at_binning(config.camera.pitch_factor)})
