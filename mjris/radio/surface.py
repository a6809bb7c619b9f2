"""The surface: what its elements make of what reaches them. Nobody else puts their amplitude into anything."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.jit.compiled import compiled, inlined
from mjris.radio.links import Channels

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]


class Surface(NamedTuple):
    """What the elements of all panels of a cell are like."""

    amplitude: float
    """β, the modulus of a reflection coefficient."""

    @classmethod
    def of(cls, radio: Radio) -> "Surface":
        """With the numbers of a config."""
        return cls(radio.element_amplitude)


@inlined
def coefficient(surface: Surface, turn: complex) -> complex:
    """Reflection coefficient β e^{jθ} of an element that is set to e^{jθ}, an entry of Θ."""
    return surface.amplitude * turn


@inlined
def element_amplitude(surface: Surface, incident: float, reflected: float) -> float:
    """Mean amplitude of the path over one element, for the mean power gains of its two links."""
    return surface.amplitude * math.sqrt(incident * reflected)


@compiled
def element_amplitudes(surface: Surface, incident: float, reflected: FloatArray) -> FloatArray:
    """`element_amplitude` [n] for the links from one panel to n places."""
    found = np.empty(len(reflected))
    for place in range(len(found)):
        found[place] = element_amplitude(surface, incident, reflected[place])
    return found


def effective_channel(surface: Surface, channels: Channels, phases_rad: FloatArray) -> ComplexArray:
    """H = h_d + h_r Θ G [..., K, M], the factor in eq. (yt), with elements set to phases [..., N] [rad]."""
    flat = flattened(channels)
    phases_rad = np.broadcast_to(phases_rad, channels.incident.shape[:-1])
    made = _effective_all(surface, *flat, np.ascontiguousarray(phases_rad).reshape(len(flat.direct), -1))
    return made.reshape(channels.direct.shape)


def cascade(surface: Surface, channels: Channels) -> ComplexArray:
    """The path over every element at phase zero, h_r[k, n] φ_n G[n, m]: [..., N, K, M]."""
    onward = coefficient(surface, 1 + 0j) * np.swapaxes(channels.reflected, -1, -2)
    return onward[..., None] * channels.incident[..., None, :]


def flattened(channels: Channels) -> Channels:
    """Channels with all leading axes in one, contiguous: what compiled loops take."""
    return Channels(*(np.ascontiguousarray(link).reshape(-1, *link.shape[-2:]) for link in channels))


@compiled
def _effective_all(
    surface: Surface, direct: ComplexArray, incident: ComplexArray, reflected: ComplexArray, phases_rad: FloatArray
) -> ComplexArray:
    made, turns = np.empty(direct.shape, np.complex128), np.empty(phases_rad.shape[1], np.complex128)
    for cell in range(len(made)):
        for n in range(len(turns)):
            turns[n] = complex(math.cos(phases_rad[cell, n]), math.sin(phases_rad[cell, n]))
        made[cell] = effective(surface, direct[cell], incident[cell], reflected[cell], turns)
    return made


@compiled
def effective(
    surface: Surface, direct: ComplexArray, incident: ComplexArray, reflected: ComplexArray, turns: ComplexArray
) -> ComplexArray:
    """`effective_channel` [K, M] of one cell, with elements set to e^{jθ} [N]."""
    channel = direct.copy()
    for k in range(channel.shape[0]):
        for n in range(len(turns)):
            through = reflected[k, n] * coefficient(surface, turns[n])
            for m in range(channel.shape[1]):
                channel[k, m] += through * incident[n, m]
    return channel
