"""What is drawn of a run against time or frequency, declared as all quantities are."""

from dataclasses import dataclass
from typing import Annotated

from processing.quantity import Quantity

_ANGLE = ("arcsec", "rad")


@dataclass(frozen=True, slots=True)
class Traces:
    """One point of every curve that a page draws of a run; amplitude and period are the balance's own."""

    elapsed_s: Annotated[float, Quantity("t", "time since the record began", "s")]
    deflection_x: Annotated[float, Quantity("X", "deflection across the swing", *_ANGLE)]
    deflection_y: Annotated[float, Quantity("Y", "deflection along the swing", *_ANGLE)]
    amplitude_residual: Annotated[float, Quantity("amplitude − fit", "what a fit leaves over", *_ANGLE)]
    period_residual: Annotated[float, Quantity("period − fit", "what a fit leaves over", "ms", "s")]
    amplitude_residual_in_u: Annotated[
        float, Quantity("(a − fit) / u", "what a fit of the amplitudes leaves over its uncertainty", unit="1")
    ]
    period_residual_in_u: Annotated[
        float, Quantity("(T − fit) / u", "what a fit of the periods leaves over its uncertainty", unit="1")
    ]
    frequency_hz: Annotated[float, Quantity("f", "frequency", "Hz", "Hz")]
    density_rad_per_rthz: Annotated[
        float,
        Quantity("density", "root of the spectral density", "arcsec/sqrt(Hz)", "rad/sqrt(Hz)"),
    ]
    left_density_rad_per_rthz: Annotated[
        float,
        Quantity("besides the swing", "root of the spectral density", "arcsec/sqrt(Hz)", "rad/sqrt(Hz)"),
    ]
    ground_m_per_s2_rthz: Annotated[
        float,
        Quantity(
            "ground",
            "acceleration of the base that alone would leave this",
            "nm/s^2/sqrt(Hz)",
            "m/s^2/sqrt(Hz)",
        ),
    ]
    sharpness_per_px: Annotated[float, Quantity("sharpness", "larger is sharper", "1/px", "1/px")]
    level_dn: Annotated[float, Quantity("level", "grey value of a pixel", "DN", "DN")]
    pixels: Annotated[float, Quantity("lg(1 + pixels)", "pixels of a grey value, as a logarithm", unit="1")]
