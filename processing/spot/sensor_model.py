"""Noise model of a pixel, from which the fit takes its weights."""

from dataclasses import dataclass, field
from typing import NamedTuple

from processing.arrays import Floats
from processing.kernel import kernel

LEAST_VARIANCE_DN2 = 1.0 / 12.0
"""Smallest variance of a pixel: that of rounding to whole DN (uniform distribution of width 1)."""


class PixelNoise(NamedTuple):
    """Noise model in the form used by the kernels.

    A pixel with background B and the spot's light L has the variance
    ``at_zero_dn2 + (B + L) dn_per_e + L^2 prnu2`` in DN^2.
    """

    at_zero_dn2: float
    """The variance is a straight line in the pixel's value; this is its value extrapolated to 0 DN."""
    dn_per_e: float
    """Inverse gain, DN per electron: shot noise has the variance light * dn_per_e."""
    full_scale_dn: float
    prnu2: float
    """Squared relative standard deviation of the pixels' response (photo-response non-uniformity)."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Noise model of the sensor, for the tracker's weights and uncertainties.

    The variance of a pixel is ``(read_noise_e / gain_e_per_dn)^2 + 1/12 + light_dn / gain_e_per_dn``
    in DN^2: read noise, quantisation, shot noise. Light is everything above `pedestal_dn`; with the default 0
    the whole background counts as light. `prnu`, the photo-response non-uniformity, adds
    ``(prnu * spot_dn)^2``, where spot_dn is the spot's own light. The configuration checks the ranges.
    """

    gain_e_per_dn: float = field(metadata={"gt": 0})
    read_noise_e: float = field(metadata={"ge": 0})
    full_scale_dn: float = field(metadata={"gt": 1})
    pedestal_dn: float = field(
        default=0.0, metadata={"ge": 0, "description": "level of a pixel in the dark; above it is light"}
    )
    prnu: float = field(
        default=0.0,
        metadata={"ge": 0, "lt": 0.2, "description": "relative spread of the pixels' response to light"},
    )
    hot_pixels_xy: tuple[tuple[int, int], ...] = field(
        default=(), metadata={"description": "pixels (x, y) of a frame that are left out of every fit"}
    )

    @property
    def dark_variance_dn2(self) -> float:
        """Variance of a pixel without light, quantisation included."""
        return (self.read_noise_e / self.gain_e_per_dn) ** 2 + LEAST_VARIANCE_DN2

    @property
    def pixel_noise(self) -> PixelNoise:
        """This model in the form used by the kernels.

        The variance at 0 DN is an extrapolation below the pedestal, and is negative for a high pedestal.
        """
        return PixelNoise(
            at_zero_dn2=self.dark_variance_dn2 - self.pedestal_dn / self.gain_e_per_dn,
            dn_per_e=1.0 / self.gain_e_per_dn,
            full_scale_dn=self.full_scale_dn,
            prnu2=self.prnu**2,
        )


@kernel
def pixel_noise_of(values: Floats) -> PixelNoise:
    """`PixelNoise` from an array of its fields; numba takes a NamedTuple argument from Python only slowly."""
    return PixelNoise(values[0], values[1], values[2], values[3])


@kernel
def background_variance(background_dn: float, noise: PixelNoise) -> float:
    """Variance in DN^2 of a pixel that receives only the background."""
    return float(max(noise.at_zero_dn2 + background_dn * noise.dn_per_e, LEAST_VARIANCE_DN2))
