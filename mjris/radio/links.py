"""The links of a slot from where everything stands, compiled: `channel` and `propagation` in one pass."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.jit import vectors
from mjris.jit.compiled import compiled, inlined
from mjris.radio.channel import Channels

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


class Medium(NamedTuple):
    """What a link is like beside its geometry."""

    frequency_db: float
    """20 log10 of the carrier in MHz."""
    rician_k: float
    """Of links in line of sight, linear."""
    cosine: bool
    """Whether the panel's elements have the cosine pattern, and not the isotropic one."""
    exponent: float
    """Of the cosine pattern."""

    @classmethod
    def of(cls, radio: Radio) -> "Medium":
        """With the numbers of a config."""
        return cls(
            20 * math.log10(radio.carrier_hz / 1e6),
            10 ** (radio.rician_k_db / 10),
            radio.element_pattern == "cosine",
            radio.element_exponent,
        )


class Means(NamedTuple):
    """What the links AP–users, RIS–users, AP–RIS are like without fading, [E, 2K + 1] each."""

    loss_db: FloatArray
    """Path loss [dB]."""
    amplitude: FloatArray
    """Path loss and the pattern of the panel's elements."""
    k_factor: FloatArray
    """Of Rician fading, linear."""


@compiled
def ends(ap: FloatArray, panel: FloatArray, receivers: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the links AP–users, RIS–users, AP–RIS start and end, both [E, 2K + 1, 3] [m].

    They end at the AP or at the panel, `ap` and `panel` [E, 3] [m], and start at `receivers` [E, K, 3] [m] or the AP.
    """
    cells, users = receivers.shape[:2]
    start, end = np.empty((cells, 2 * users + 1, 3)), np.empty((cells, 2 * users + 1, 3))
    for e in range(cells):
        for i in range(3):
            start[e, 2 * users, i], end[e, 2 * users, i] = ap[e, i], panel[e, i]
            for k in range(users):
                start[e, k, i] = start[e, users + k, i] = receivers[e, k, i]
                end[e, k, i], end[e, users + k, i] = ap[e, i], panel[e, i]
    return start, end


@compiled
def means(medium: Medium, start: FloatArray, end: FloatArray, blockers: IntArray, heading: FloatArray) -> Means:
    """`Means` of links as `ends` has them, with `blockers` [E, 2K + 1] in their way, for panels facing `heading` [E].

    `propagation.path_loss_db` and `channel.pattern_gain`.
    """
    made = Means(np.empty(blockers.shape), np.empty(blockers.shape), np.empty(blockers.shape))
    for e in range(blockers.shape[0]):
        forward_x, forward_y = math.cos(heading[e]), math.sin(heading[e])
        for link in range(blockers.shape[1]):
            x, y = start[e, link, 0] - end[e, link, 0], start[e, link, 1] - end[e, link, 1]
            z = start[e, link, 2] - end[e, link, 2]
            distance = math.sqrt(x * x + y * y + z * z)
            made.loss_db[e, link] = path_loss_db(medium, distance, blockers[e, link])
            gain = 10.0 ** (-made.loss_db[e, link] / 10)
            if link >= blockers.shape[1] // 2:
                gain *= pattern_gain(medium, (forward_x * x + forward_y * y) / max(distance, 1e-12))
            made.amplitude[e, link] = math.sqrt(gain)
            made.k_factor[e, link] = 0.0 if blockers[e, link] > 0 else medium.rician_k
    return made


@compiled
def path_loss_db(medium: Medium, distance_m: float, blockers: int) -> float:
    """`propagation.path_loss_db` of one link."""
    at_a_metre, a_decade = _loss_terms_db(medium, blockers)
    return at_a_metre + a_decade * math.log10(max(distance_m, 1.0))


@inlined
def _loss_terms_db(medium: Medium, blockers: int) -> tuple[float, float]:
    """Path loss at one metre, and how much it grows in a decade of distance, eqs. (PLLOS) and (PLNLOS)."""
    if blockers > 0:
        return medium.frequency_db - 28 + 15 + 4 * (blockers - 1), 25.5
    return medium.frequency_db - 27.2, 16.9


@compiled
def bisectors(
    receivers: FloatArray, x: FloatArray, y: FloatArray, forward_x: FloatArray, forward_y: FloatArray
) -> None:
    """Write vectors in the directions that panels at P places should face: between the AP and the users' middle.

    `receivers` [K + 1, 2 or 3] [m] are the users and, last, the AP; all others are [P], places in m.
    """
    users = len(receivers) - 1
    forward_x[:], forward_y[:] = 0, 0
    for k in range(users):
        _add_units(receivers[k], x, y, forward_x, forward_y)
    for p in range(len(x)):
        forward_x[p], forward_y[p] = _unit(forward_x[p], forward_y[p])
    _add_units(receivers[users], x, y, forward_x, forward_y)


@compiled
def _add_units(end: FloatArray, x: FloatArray, y: FloatArray, forward_x: FloatArray, forward_y: FloatArray) -> None:
    """Add the unit vectors from places toward an end."""
    for p in range(len(x)):
        toward_x, toward_y = _unit(end[0] - x[p], end[1] - y[p])
        forward_x[p] += toward_x
        forward_y[p] += toward_y


@inlined
def _unit(x: float, y: float) -> tuple[float, float]:
    """The vector with length one; zero stays zero."""
    length = math.sqrt(x * x + y * y)
    return (x / length, y / length) if length > 0 else (0.0, 0.0)


@compiled
def pattern_gain(medium: Medium, cosine: float) -> float:
    """`channel.pattern_gain` for one direction."""
    if not medium.cosine:
        return 1.0
    return 2 * (medium.exponent + 1) * cosine**medium.exponent if cosine > 0 else 0.0


@inlined
def panel_gain(medium: Medium, squared_m: float, blockers: int, cosine: float) -> float:
    """Power gain of one link of the panel, from its squared length [m²]: 10^(-L/10) times `pattern_gain`.

    One exponential for both, as a radio map has thousands of them.
    """
    at_a_metre, a_decade = _loss_terms_db(medium, blockers)
    exponent = -math.log(10) / 10 * at_a_metre - a_decade / 20 * vectors.log(max(squared_m, 1.0))
    sharpness = medium.exponent if medium.cosine else 0.0
    ahead = 2 * (medium.exponent + 1) if medium.cosine else 1.0
    gain = ahead * vectors.exp(exponent + sharpness * vectors.log(max(cosine, 1e-300)))
    return gain if cosine > 0 or not medium.cosine else 0.0


@compiled
def panel_elements(centre: FloatArray, heading: FloatArray, rows: int, cols: int, spacing_m: float) -> FloatArray:
    """`channel.panel_elements` [E, N, 3] [m] for `centre` [E, 3] [m] and `heading` [E] [rad]."""
    places = np.empty((len(centre), rows * cols, 3))
    for e in range(len(centre)):
        x, y = -math.sin(heading[e]), math.cos(heading[e])
        for n in range(rows * cols):
            along_row = spacing_m * (n % cols - (cols - 1) / 2)
            places[e, n, 0] = centre[e, 0] + x * along_row
            places[e, n, 1] = centre[e, 1] + y * along_row
            places[e, n, 2] = centre[e, 2] + spacing_m * (n // cols - (rows - 1) / 2)
    return places


def channels(
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    mean: Means,
    diffuse: ComplexArray,
    wavelength_m: float,
) -> Channels:
    """Channels of E cells with K users, M antennas and N elements.

    `antennas` [E, M, 3], `receivers` [E, K, 3] and `elements` [E, N, 3] are places [m], so that every entry has the
    phase of its own distance, `channel.phase_ramp`. `diffuse` [E, K M + N M + K N] is the diffuse part of h_d, G and
    h_r, for `propagation.rician`.
    """
    cells, users, rows = len(receivers), receivers.shape[1], elements.shape[1]
    columns = antennas.shape[1]
    made = Channels(
        np.empty((cells, users, columns), np.complex128),
        np.empty((cells, rows, columns), np.complex128),
        np.empty((cells, users, rows), np.complex128),
    )
    _fill(*made, antennas, receivers, elements, mean.amplitude, mean.k_factor, diffuse, wavelength_m)
    return made


@compiled
def _fill(
    direct: ComplexArray,
    incident: ComplexArray,
    reflected: ComplexArray,
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    amplitude: FloatArray,
    k_factor: FloatArray,
    diffuse: ComplexArray,
    wavelength_m: float,
) -> None:
    users, rows, columns = receivers.shape[1], elements.shape[1], antennas.shape[1]
    away = np.empty(rows * columns)
    for e in range(len(receivers)):
        at = 0
        for k in range(users):
            _distances(receivers[e, k : k + 1], antennas[e], wavelength_m, away)
            at = _fill_link(direct[e, k], away, amplitude[e, k], k_factor[e, k], diffuse[e], at)
        _distances(elements[e], antennas[e], wavelength_m, away)
        at = _fill_link(incident[e].ravel(), away, amplitude[e, -1], k_factor[e, -1], diffuse[e], at)
        for k in range(users):
            _distances(receivers[e, k : k + 1], elements[e], wavelength_m, away)
            at = _fill_link(reflected[e, k], away, amplitude[e, users + k], k_factor[e, users + k], diffuse[e], at)


@compiled
def _distances(ends: FloatArray, starts: FloatArray, wavelength_m: float, away: FloatArray) -> None:
    """Write distances between places [A, 3] and [B, 3] [m] to `away` [≥ A B], in wavelengths."""
    entry = 0
    for end in range(len(ends)):
        for start in range(len(starts)):
            x, y, z = (
                ends[end, 0] - starts[start, 0],
                ends[end, 1] - starts[start, 1],
                ends[end, 2] - starts[start, 2],
            )
            away[entry] = math.sqrt(x * x + y * y + z * z) / wavelength_m
            entry += 1


@compiled
def _fill_link(
    entries: ComplexArray, away: FloatArray, amplitude: float, k_factor: float, diffuse: ComplexArray, at: int
) -> int:
    """Write all entries [n] of a link, with their diffuse parts from `at` on; where those end. h of eq. (PL)."""
    scattered = amplitude / math.sqrt(k_factor + 1)
    los = math.sqrt(k_factor) * scattered
    for entry in range(len(entries)):
        entries[entry] = los * vectors.phasor(away[entry]) + scattered * diffuse[at + entry]
    return at + len(entries)
