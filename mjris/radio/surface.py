"""The surface: what its elements make of what reaches them. Nobody else puts their amplitude into anything."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Hardware, Radio
from mjris.jit.compiled import compiled, inlined, reducing
from mjris.radio.links import Channels

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

_PHASES = 720
"""Phases that a mean goes over."""
_FLAT = 1e-12
"""Where the dip of the amplitude is taken for flat: a power below one has no slope there."""


class Surface(NamedTuple):
    """What the elements of all panels of a cell are like."""

    amplitude: float
    """β, the largest modulus of a reflection coefficient."""
    step_rad: float = 0.0
    """Between the phases that elements can take; zero for any."""
    least: float = 1.0
    """Least modulus over the phase, as a share of the largest one."""
    steepness: float = 0.0
    offset_rad: float = 0.0

    @classmethod
    def of(cls, radio: Radio) -> "Surface":
        """With the numbers of a config."""
        made, bits = radio.surface, radio.surface.phase_bits
        step_rad = 2 * math.pi / 2**bits if bits else 0.0
        offset_rad = math.radians(made.amplitude_offset_deg)
        return cls(radio.element_amplitude, step_rad, made.least_amplitude, made.amplitude_steepness, offset_rad)

    @property
    def unstepped(self) -> "Surface":
        """The same with elements that take any phase."""
        return self._replace(step_rad=0.0)

    @property
    def ideal(self) -> "Surface":
        """A surface that can do whatever this one can, and reflects all of it at any phase."""
        return Surface(self.amplitude)


@inlined
def is_ideal(surface: Surface) -> bool:
    """Whether elements take any phase, at one amplitude."""
    return surface.step_rad == 0 and surface.least == 1


@inlined
def coefficient(surface: Surface, turn: complex) -> complex:
    """Reflection coefficient of an element that is set to e^{jθ}, an entry of Θ.

    β e^{jθ} if ideal. Else θ goes to the nearest phase that there is, and its modulus follows from that, with a share m
    of β where least is left: β ((1 - m) ((sin(θ - φ) + 1)/2)^k + m) e^{jθ} (arXiv 1907.06002).
    """
    if is_ideal(surface):
        return surface.amplitude * turn
    phase = math.atan2(turn.imag, turn.real)
    if surface.step_rad > 0:
        phase = surface.step_rad * math.floor(phase / surface.step_rad + 0.5)
    dip = ((math.sin(phase - surface.offset_rad) + 1) / 2) ** surface.steepness
    modulus = surface.amplitude * ((1 - surface.least) * dip + surface.least)
    return complex(modulus * math.cos(phase), modulus * math.sin(phase))


class Mean(NamedTuple):
    """What elements do on average over the phases that are wanted of them."""

    coherent: float
    """Amplitude toward the wanted phase."""
    power: float
    """Squared modulus."""


@cache  # as it is asked for in every slot
def mean_coefficient(radio: Radio) -> Mean:
    """`Mean` of a config's elements, phase noise and dead ones included.

    Noise of standard deviation σ leaves e^{-σ²/2} of what is coherent.
    """
    wanted = np.exp(2j * np.pi * (np.arange(_PHASES) + 0.5) / _PHASES)
    surface, made = Surface.of(radio), radio.surface
    if is_ideal(surface):
        coherent, power = surface.amplitude, surface.amplitude**2
    else:
        sent = np.array([coefficient(surface, turn) for turn in wanted])
        coherent, power = float(np.real(sent * wanted.conj()).mean()), float((abs(sent) ** 2).mean())
    alive, steady = 1 - made.dead_share, math.exp(-(math.radians(made.phase_noise_deg) ** 2) / 2)
    return Mean(coherent * alive * steady, power * alive)


def power_drawn_w(made: Hardware, counts: NDArray[np.int64]) -> float:
    """What panels of so many elements [S] draw in all: controllers, drivers and elements [W]."""
    drivers = -(-counts // made.elements_per_driver)
    return float((made.board_w + made.driver_w * drivers + made.element_w * counts).sum())


def effective_channel(surface: Surface, channels: Channels, phases_rad: FloatArray) -> ComplexArray:
    """H = h_d + h_r Θ G [..., K, M], the factor in eq. (yt), with elements set to phases [..., N] [rad]."""
    shape = channels.incident.shape[:-1]
    if phases_rad.shape != shape:  # which takes longer than a slot of few elements
        phases_rad = np.broadcast_to(phases_rad, shape)
    phases_rad = np.ascontiguousarray(phases_rad).reshape(-1, shape[-1])
    return _effective_all(surface, *flattened(channels), phases_rad).reshape(channels.direct.shape)


def cascade(channels: Channels) -> ComplexArray:
    """The path over every element before its coefficient, h_r[k, n] G[n, m]: [..., N, K, M]."""
    return np.swapaxes(channels.reflected, -1, -2)[..., None] * channels.incident[..., None, :]


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


@compiled
def sent(surface: Surface, turns: FloatArray) -> FloatArray:
    """The parts [2, N] of the coefficients of elements that are set to e^{jθ}, whose parts are `turns` [2, N]."""
    if is_ideal(surface):
        return surface.amplitude * turns
    made = np.empty_like(turns)
    for n in range(turns.shape[1]):
        through = coefficient(surface, complex(turns[0, n], turns[1, n]))
        made[0, n], made[1, n] = through.real, through.imag
    return made


@compiled
def slopes(surface: Surface, turns: FloatArray) -> FloatArray:
    """How the coefficients of elements that take any phase change with it, parts [2, N] as in `sent`."""
    made = np.empty_like(turns)
    for n in range(turns.shape[1]):
        made[0, n], made[1, n] = -surface.amplitude * turns[1, n], surface.amplitude * turns[0, n]
    if surface.least < 1:
        for n in range(turns.shape[1]):
            turn = complex(turns[0, n], turns[1, n])
            beyond = math.atan2(turn.imag, turn.real) - surface.offset_rad
            dip = max((math.sin(beyond) + 1) / 2, _FLAT)
            bend = surface.steepness * dip ** (surface.steepness - 1) * math.cos(beyond) / 2
            through = 1j * coefficient(surface, turn) + surface.amplitude * (1 - surface.least) * bend * turn
            made[0, n], made[1, n] = through.real, through.imag
    return made


@compiled
def pulled(over: Parts, toward: ComplexArray) -> FloatArray:
    """The parts [2, N] of Σ_km t_km h_r[k, n] G[n, m] for `toward` [K, M]."""
    elements = over.incident.shape[2]
    pull, onward = np.zeros((2, elements)), np.empty((2, elements))
    for k in range(over.reflected.shape[1]):
        onward[:] = 0
        for m in range(over.incident.shape[1]):
            beam, real, imag = toward[k, m], over.incident[0, m], over.incident[1, m]
            for n in range(elements):
                onward[0, n] += real[n] * beam.real - imag[n] * beam.imag
                onward[1, n] += real[n] * beam.imag + imag[n] * beam.real
        real, imag = over.reflected[0, k], over.reflected[1, k]
        for n in range(elements):
            pull[0, n] += real[n] * onward[0, n] - imag[n] * onward[1, n]
            pull[1, n] += real[n] * onward[1, n] + imag[n] * onward[0, n]
    return pull


@reducing
def effective(surface: Surface, direct: ComplexArray, over: Parts, turns: FloatArray) -> ComplexArray:
    """`effective_channel` [K, M] of one cell, with elements set to e^{jθ}, whose parts are `turns` [2, N]."""
    channel, onward, through = direct.copy(), np.empty_like(turns), sent(surface, turns)
    for k in range(channel.shape[0]):
        real, imag = over.reflected[0, k], over.reflected[1, k]
        for n in range(turns.shape[1]):
            onward[0, n] = real[n] * through[0, n] - imag[n] * through[1, n]
            onward[1, n] = real[n] * through[1, n] + imag[n] * through[0, n]
        for m in range(channel.shape[1]):
            real, imag = over.incident[0, m], over.incident[1, m]
            total_real, total_imag = 0.0, 0.0
            for n in range(turns.shape[1]):
                total_real += onward[0, n] * real[n] - onward[1, n] * imag[n]
                total_imag += onward[0, n] * imag[n] + onward[1, n] * real[n]
            channel[k, m] += complex(total_real, total_imag)
    return channel
