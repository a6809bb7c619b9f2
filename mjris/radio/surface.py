"""The surface: what its elements make of what reaches them. Nobody else puts their amplitude into anything."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.jit.compiled import compiled, inlined, reducing
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
    shape = channels.incident.shape[:-1]
    if phases_rad.shape != shape:  # which takes longer than a slot of few elements
        phases_rad = np.broadcast_to(phases_rad, shape)
    phases_rad = np.ascontiguousarray(phases_rad).reshape(-1, shape[-1])
    return _effective_all(surface, *flattened(channels), phases_rad).reshape(channels.direct.shape)


def cascade(surface: Surface, channels: Channels) -> ComplexArray:
    """The path over every element at phase zero, h_r[k, n] φ_n G[n, m]: [..., N, K, M]."""
    onward = coefficient(surface, 1 + 0j) * np.swapaxes(channels.reflected, -1, -2)
    return onward[..., None] * channels.incident[..., None, :]


def flattened(channels: Channels) -> Channels:
    """Channels with all leading axes in one, contiguous: what compiled loops take."""
    return Channels(*(np.ascontiguousarray(link).reshape(-1, *link.shape[-2:]) for link in channels))


class Parts(NamedTuple):
    """Channels of one cell with real and imaginary parts apart, elements last: loops over elements are vectors."""

    incident: FloatArray
    """[2, M, N]"""
    reflected: FloatArray
    """[2, K, N]"""


@compiled
def parts(incident: ComplexArray, reflected: ComplexArray) -> Parts:
    """The parts of channels [N, M] and [K, N]."""
    made = Parts(np.empty((2, incident.shape[1], incident.shape[0])), np.empty((2, *reflected.shape)))
    for n in range(incident.shape[0]):
        for m in range(incident.shape[1]):
            made.incident[0, m, n], made.incident[1, m, n] = incident[n, m].real, incident[n, m].imag
    for k in range(reflected.shape[0]):
        for n in range(reflected.shape[1]):
            made.reflected[0, k, n], made.reflected[1, k, n] = reflected[k, n].real, reflected[k, n].imag
    return made


@compiled
def _effective_all(
    surface: Surface, direct: ComplexArray, incident: ComplexArray, reflected: ComplexArray, phases_rad: FloatArray
) -> ComplexArray:
    made, turns = np.empty(direct.shape, np.complex128), np.empty((2, phases_rad.shape[1]))
    for cell in range(len(made)):
        for n in range(turns.shape[1]):
            turns[0, n], turns[1, n] = math.cos(phases_rad[cell, n]), math.sin(phases_rad[cell, n])
        made[cell] = effective(surface, direct[cell], parts(incident[cell], reflected[cell]), turns)
    return made


@reducing
def effective(surface: Surface, direct: ComplexArray, over: Parts, turns: FloatArray) -> ComplexArray:
    """`effective_channel` [K, M] of one cell, with elements set to e^{jθ}, whose parts are `turns` [2, N]."""
    channel, onward = direct.copy(), np.empty_like(turns)
    for k in range(channel.shape[0]):
        real, imag = over.reflected[0, k], over.reflected[1, k]
        for n in range(turns.shape[1]):
            through = coefficient(surface, complex(turns[0, n], turns[1, n]))
            onward[0, n] = real[n] * through.real - imag[n] * through.imag
            onward[1, n] = real[n] * through.imag + imag[n] * through.real
        for m in range(channel.shape[1]):
            real, imag = over.incident[0, m], over.incident[1, m]
            total_real, total_imag = 0.0, 0.0
            for n in range(turns.shape[1]):
                total_real += onward[0, n] * real[n] - onward[1, n] * imag[n]
                total_imag += onward[0, n] * imag[n] + onward[1, n] * real[n]
            channel[k, m] += complex(total_real, total_imag)
    return channel
