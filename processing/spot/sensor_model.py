"""Noise of a pixel, as the fit weighs it."""

from dataclasses import dataclass

from processing.errors import DataError

LEAST_VARIANCE_DN2 = 1.0 / 12.0
"""Quantisation's own, which no pixel is without."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """What a pixel's value is worth.

    The variance of a pixel is ``(read_noise_e / gain_e_per_dn)^2 + 1/12 + light_dn / gain_e_per_dn``
    in DN^2: read noise, quantisation, shot noise. Light is everything above `pedestal_dn`, the level
    of a pixel in the dark; with the default 0 the whole background counts as light. `prnu` is the
    relative spread of the pixels' response; it adds ``(prnu * spot_dn)^2``, of the spot's own light.

    Raises
    ------
    DataError
        A gain or full scale that is not positive, a negative read noise, pedestal or PRNU.
    """

    gain_e_per_dn: float
    read_noise_e: float
    full_scale_dn: float
    pedestal_dn: float = 0.0
    prnu: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("gain_e_per_dn", self.gain_e_per_dn), ("full_scale_dn", self.full_scale_dn)):
            if not value > 0:
                raise DataError(f"sensor model: {name} = {value!r} must be positive")
        for name in ("read_noise_e", "pedestal_dn", "prnu"):
            value = getattr(self, name)
            if not value >= 0:
                raise DataError(f"sensor model: {name} = {value!r} must not be negative")

    @property
    def dark_variance_dn2(self) -> float:
        """Variance of a pixel without light, quantisation included."""
        return (self.read_noise_e / self.gain_e_per_dn) ** 2 + LEAST_VARIANCE_DN2

    @property
    def variance_at_zero_dn2(self) -> float:
        """What the variance's straight line in the pixel's level would be at level 0.

        Below the pedestal no light is left, and no pixel is that dark; negative for a high pedestal.
        """
        return self.dark_variance_dn2 - self.pedestal_dn / self.gain_e_per_dn
