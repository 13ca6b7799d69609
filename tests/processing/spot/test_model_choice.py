"""How many windows a model is chosen from: fewer of a large spot, between two limits."""

import numpy as np
import pytest

from processing.spot.model_choice import ModelChoice, SpotModel
from processing.spot.sensor_model import PixelNoise


@pytest.mark.parametrize(("side_px", "windows"), [(20, 32), (200, 25), (400, 16)])
def test_a_large_spot_is_judged_by_fewer_windows(side_px: int, windows: int) -> None:
    choice = ModelChoice(PixelNoise(1.0, 0.0, 255.0, 0.0), lambda *_: None)
    image = np.zeros((side_px, side_px), np.uint8)
    seen = 0
    while choice.model is None:
        choice.add(0.5, 0, float(side_px**2), lambda: (image, (0, 0)))
        seen += 1
    assert choice.model is SpotModel.ONE
    assert seen == 4 * windows
