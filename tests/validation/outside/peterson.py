"""Peterson's noise models: the program's against the published curves, and the simulated ground against
both."""

import numpy as np
import scipy

from acquisition.simulation.ground import FAST, SLOW, ground_of
from acquisition.simulation.settings import SimulationSettings
from processing.noise_models import nhnm_db, nlnm_db
from tests.validation.outside.shared import shared
from tests.validation.row import Found

RATE_HZ = 25.0
_HOURS = 4
_BANDS_HZ = ((0.02, 0.05), (0.05, 0.1), (0.1, 0.3), (0.3, 1.0), (1.0, 4.5))


def models() -> dict[str, Found]:
    """Distance from the table of USGS open-file report 93-322, dB.

    The table is drawn through the breaks, where the models jump: the median says whether a coefficient is
    wrong as well as the largest distance does, which is that of the breaks.
    """
    table = np.genfromtxt(shared("ground/peterson.csv"), delimiter=",", names=True)
    frequency_hz = 1 / table["period_s"]
    low, high = (
        np.abs(model(frequency_hz) - table[name])
        for model, name in ((nlnm_db, "nlnm_db"), (nhnm_db, "nhnm_db"))
    )
    both = np.concatenate([low, high])
    return {
        "largest": Found((float(low.max()), float(high.max())), f"{len(low)} periods"),
        "median": Found((float(np.median(both)),)),
    }


def simulated_ground() -> dict[str, Found]:
    """Mean power of the simulated ground in five bands by scipy's Welch, over the published curves', dB."""
    table = np.genfromtxt(shared("ground/peterson.csv"), delimiter=",", names=True)
    middle_db = (table["nlnm_db"] + table["nhnm_db"]) / 2
    settings = SimulationSettings.model_validate(
        {"ground": {"model": "peterson", "between_noise_models": 0.5}, "seed": 8}
    )
    ground = ground_of(settings, 0)
    assert ground is not None
    times_s = np.arange(_HOURS * 3600 * RATE_HZ) / RATE_HZ
    off = []
    for mode in (SLOW, FAST):
        frequency_hz, power = scipy.signal.welch(
            ground.acceleration_m_per_s2[mode].at(times_s), RATE_HZ, nperseg=2**13
        )
        for low_hz, high_hz in _BANDS_HZ:
            band = (frequency_hz >= low_hz) & (frequency_hz < high_hz)
            level_db = np.interp(-np.log(frequency_hz[band]), np.log(table["period_s"]), middle_db)
            off.append(10 * np.log10(np.mean(power[band]) / np.mean(10 ** (level_db / 10))))
    return {
        "off": Found(tuple(float(value) for value in off), f"{_HOURS} h, {len(_BANDS_HZ)} bands, both axes")
    }
