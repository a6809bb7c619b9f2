"""What estimated channels have of the true ones: errors, and age."""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mjris.radio.links import Channels

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]


def clarke(displacement_m: FloatArray, wavelength_m: float) -> FloatArray:
    """Correlation J0(2πΔ/λ) of diffuse fading over a displacement Δ [...] [m] (Clarke 1968)."""
    return special.j0(2 * np.pi / wavelength_m * displacement_m)


def aged(diffuse: ComplexArray, innovation: ComplexArray, correlation: FloatArray) -> ComplexArray:
    """Diffuse fading [...] as it was when it had this `correlation` [...] with today's; its mean power stays one."""
    return correlation * diffuse + np.sqrt(1 - correlation**2) * innovation


def estimated(channels: Channels, errors: Channels, gains: Channels, nmse: float) -> Channels:
    """Channels with `errors` of unit power, scaled so that E|ĥ - h|² is `nmse` times the mean power `gains`."""
    scale = np.sqrt(nmse)
    return Channels(*(h + scale * np.sqrt(g) * e for h, e, g in zip(channels, errors, gains, strict=True)))
