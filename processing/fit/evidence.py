"""What a fit knows beside the turning points: the waveform of the swing, and what the air is expected to do.

A drag takes energy as friction does that grows with the amplitude, so that turning points hardly tell them
apart on ground that moves. Within a swing they differ: friction turns over at each turning point and makes
odd harmonics in quadrature, a drag makes none. Neither a lever that is not straight nor errors of place on
the sensor make such harmonics, whatever the ground does slowly makes none, and even orders, to which rows
exposed in turn belong, are left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, Law, PendulumOnBall, law_harmonics
from processing.estimate import Estimate
from processing.fit.known_drive import KnownDrive
from processing.least_squares import FactoredJacobian
from processing.swing import ORDERS, SwingHarmonics

WAVEFORM, AIR = "waveform", "air"
"""Names of what restrains a fit beside the turning points."""
_ODD = [ORDERS.index(order) for order in (3, 5, 7, 9)]
_NODE = 1.6
"""Ratio of neighbouring amplitudes at which the harmonics are kept; between them they are interpolated."""
_FEWEST = 8
"""Fewest pieces that are a waveform: their scatter is half of what is said of their uncertainty."""
_STATED = 10.0
"""How many pieces the stated uncertainties of the samples count for in the covariance of the harmonics."""
_KEPT = 32
"""Predictions that a waveform keeps: a fit and the verdicts on it ask for those at the same values again."""
_GATE = 5.0
"""Standard deviations beyond which a harmonic is one of a disturbed piece."""


@dataclass(frozen=True, eq=False)
class Waveform:
    """Odd harmonics in quadrature of the swing over a decay, with the covariance that they show.

    Attributes
    ----------
    amplitude_rad
        Amplitudes (n,) of the pieces.
    sine_rad
        Their harmonics of orders 3, 5, 7 and 9 (n, 4).
    covariance
        Of one piece's harmonics, (n, 4, 4): that of the samples, enlarged to what neighbours scatter. The
        ground's part is in it, whatever its spectrum.
    scatter
        Ratio of the scatter to what the stated uncertainties of the samples say, as standard deviations.
    """

    amplitude_rad: Floats
    sine_rad: Floats
    covariance: Floats
    scatter: float

    @cached_property
    def _hats(self) -> Floats:
        """Weights (n, nodes) of linear interpolation in ln A."""
        x = np.log(self.amplitude_rad)
        span = float(x.max() - x.min())
        nodes = np.linspace(x.min(), x.max(), max(2, round(span / log(_NODE)) + 1))
        place = (x - nodes[0]) / (nodes[1] - nodes[0])
        return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(len(nodes)))))

    @cached_property
    def _reduction(self) -> Floats:
        """Matrix (m, 4 n) that reduces the pieces to m independent numbers of unit variance.

        Nodes with no piece about them, and what rounding leaves of orders that scatter alike, give none.
        """
        whitening = np.linalg.inv(np.linalg.cholesky(self.covariance))
        nodes, orders = self._hats.shape[1], self.sine_rad.shape[1]
        columns = np.einsum("ij,iab->iajb", self._hats, whitening).reshape(-1, nodes * orders)
        kept = FactoredJacobian(columns).directions.T.reshape(-1, len(whitening), orders)
        return np.asarray(np.einsum("kia,iab->kib", kept, whitening).reshape(len(kept), -1))

    @cached_property
    def _predictions(self) -> dict[tuple[object, ...], tuple[Law, Floats]]:
        return {}

    def predicted_rad(self, law: Law, values: Mapping[str, float], pendulum: PendulumOnBall) -> Floats:
        """What a law says that `sine_rad` are.

        Raises DataError if the pendulum would not swing.
        """
        key = (pendulum, *values.items())
        known = self._predictions.get(key)
        if known is None or known[0] is not law:
            sine = -law_harmonics(law, values, pendulum, self.amplitude_rad).imag[:, _ODD]
            while len(self._predictions) >= _KEPT:
                del self._predictions[next(iter(self._predictions))]
            known = self._predictions[key] = law, sine
        return known[1]

    def reduced(self, sine_rad: Floats) -> Floats:
        """Harmonics of the pieces as independent numbers of unit variance."""
        return np.asarray(self._reduction @ sine_rad.ravel())

    def residuals(self, law: Law, values: Mapping[str, float], pendulum: PendulumOnBall) -> Floats:
        """What a law predicts minus what is measured, as independent numbers of unit variance.

        Raises DataError if the pendulum would not swing.
        """
        return self.reduced(self.predicted_rad(law, values, pendulum) - self.sine_rad)


def sine_covariance(pieces: SwingHarmonics) -> Floats | None:
    """Covariance (4, 4) of one piece's harmonics as a `Waveform` has it; None for too few pieces."""
    found = waveform_of(pieces)
    return None if found is None else np.asarray(np.median(found.covariance, axis=0))


def waveform_of(pieces: SwingHarmonics) -> Waveform | None:
    """The waveform that pieces of a decay show; None for too few of them."""
    order = np.argsort(-pieces.amplitude)
    amplitude, sine = pieces.amplitude[order], pieces.sine[order][:, _ODD]
    stated = pieces.covariance_sine[order][:, _ODD][:, :, _ODD]
    while len(amplitude) >= _FEWEST:
        whitening = np.linalg.inv(np.linalg.cholesky(stated))
        whole = _whole_scatter(amplitude, sine, whitening)
        left = np.einsum("nab,nb->na", whitening, _left(amplitude, sine))
        kept = np.all(np.abs(left) < _GATE * np.sqrt(np.diag(whole)), axis=1)
        if np.all(kept):
            root = np.linalg.inv(whitening)
            enlarged = root @ whole @ np.swapaxes(root, 1, 2)
            return Waveform(amplitude, sine, enlarged, float(np.sqrt(np.trace(whole) / len(_ODD))))
        amplitude, sine, stated = amplitude[kept], sine[kept], stated[kept]
    return None


def _left(amplitude: Floats, sine: Floats) -> Floats:
    """What a smooth curve over the amplitudes leaves of the harmonics."""
    x = np.log(amplitude)
    x = (x - x.mean()) / max(float(np.ptp(x)), 1e-9)
    terms = amplitude[:, None] * x[:, None] ** np.arange(3)
    return FactoredJacobian(terms).left(sine)


def _whole_scatter(amplitude: Floats, sine: Floats, whitening: Floats) -> Floats:
    """Covariance of whitened harmonics (4, 4), from what they scatter, with the stated one as a prior.

    Where they scatter more than stated, as in air, the prior says how the orders share the noise and not how
    much of it there is: it would else take a third off the variance of a dozen pieces.
    """
    left = np.einsum("nab,nb->na", whitening, _left(amplitude, sine))
    # pieces far off are judged against the others
    size = 1.4826 * np.median(np.abs(left), axis=0)
    left = np.clip(left, -_GATE * size, _GATE * size)
    scatter, degrees = left.T @ left, len(amplitude) - 3
    louder = max(1.0, float(np.trace(scatter)) / len(_ODD) / degrees)
    own = (degrees + _STATED) ** 2 / degrees
    return np.asarray(
        _wider(own, len(_ODD)) * (scatter + _STATED * louder * np.eye(len(_ODD))) / (degrees + _STATED)
    )


def _wider(degrees: float, order: int) -> float:
    """What a covariance matrix of so many degrees of freedom must grow by to be the weights of a fit.

    Weights from the data themselves make the fit scatter more than the best ones would and, because they
    favour what happens to scatter little, say that it scatters less (Wishart's distribution).
    """
    stated, actual = (degrees - order + 1) / degrees, (degrees - 1) / (degrees - order)
    return actual / stated


@dataclass(frozen=True)
class Evidence:
    """What restrains a fit beside the turning points.

    `drag_s` is what is known of a linear drag without this decay: its value and standard uncertainty.
    `drive` is what a witness of the ground tells of the drive, up to gains that are fitted.
    """

    waveform: Waveform | None = None
    drag_s: Estimate | None = None
    drive: KnownDrive | None = None

    def residuals(self, law: Law, values: Mapping[str, float], pendulum: PendulumOnBall | None) -> Floats:
        """Distances of what the values say from what is known, in standard uncertainties."""
        parts = []
        if self.waveform is not None and pendulum is not None:
            parts.append(self.waveform.residuals(law, values, pendulum))
        if self.drag_s is not None and DRAG.key in values:
            value, u = self.drag_s
            parts.append(np.array([(values[DRAG.key] - value) / u]))
        return np.concatenate(parts) if parts else np.zeros(0)


NO_EVIDENCE = Evidence()
