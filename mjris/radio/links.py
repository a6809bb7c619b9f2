"""The links of a slot, from where everything stands: path losses, mean amplitudes, and the channels of all entries."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit import vectors
from mjris.jit.compiled import compiled
from mjris.radio import equations
from mjris.radio.tables import LinkTable

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


class Channels(NamedTuple):
    """Complex amplitude gains of the three links; path loss, patterns and fading included, but nothing of the surface.

    The N elements of all panels follow each other.
    """

    direct: ComplexArray
    """h_d, AP to users [..., K, M]."""
    incident: ComplexArray
    """G, AP to elements [..., N, M]."""
    reflected: ComplexArray
    """h_r, elements to users [..., K, N]."""


class Links:
    """Which links there are in a cell with K users and S panels: L = K + S K + S, on one axis."""

    def __init__(self, users: int, panels: int):
        self.users, self.panels = users, panels
        self.direct = slice(0, users)
        """AP–users."""
        self.reflected = slice(users, users + panels * users)
        """Panel by panel, its links to the users."""
        self.incident = slice(self.reflected.stop, self.reflected.stop + panels)
        """AP–panels."""
        everybody, nobody = np.arange(users), np.full(panels, -1)
        self.person = np.concatenate([everybody, np.tile(everybody, panels), nobody])
        """The user at the end of every link [L], -1 for none."""
        self.panel = np.concatenate([np.full(users, -1), np.repeat(np.arange(panels), users), np.arange(panels)])
        """The panel at the end of every link [L], -1 for none."""

    def split(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values of all links [E, L] as those AP–users [E, K], AP–panels [E, S] and panels–users [E, S, K]."""
        reflected = values[:, self.reflected].reshape(len(values), self.panels, self.users)
        return values[:, self.direct], values[:, self.incident], reflected

    def ends(self, ap: FloatArray, panels: FloatArray, receivers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where links start and end, both [E, L, 3] [m].

        They end at the AP [E, 3] or a panel [E, S, 3] [m], and start at receivers [E, K, 3] [m] or the AP.
        """
        return _ends(self.person, self.panel, ap, panels, receivers)


class Means(NamedTuple):
    """What links are like without fading, [E, L] each."""

    loss_db: FloatArray
    """Path loss [dB]."""
    gain: FloatArray
    """Power gain: path loss and the pattern of the panel's elements."""
    k_factor: FloatArray
    """Of Rician fading, linear."""


@compiled
def _ends(
    person: IntArray, panel: IntArray, ap: FloatArray, panels: FloatArray, receivers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    start, end = np.empty((len(ap), len(person), 3)), np.empty((len(ap), len(person), 3))
    for e in range(len(ap)):
        for link in range(len(person)):
            for i in range(3):
                start[e, link, i] = receivers[e, person[link], i] if person[link] >= 0 else ap[e, i]
                end[e, link, i] = panels[e, panel[link], i] if panel[link] >= 0 else ap[e, i]
    return start, end


@compiled
def means(
    table: LinkTable,
    panel: IntArray,
    start: FloatArray,
    end: FloatArray,
    obstacles: IntArray,
    heading: FloatArray,
) -> Means:
    """`Means` of links [E, L] with `obstacles` in their way, for panels [L] that face `heading` [E, S] [rad].

    `start` and `end` [E, L, 3] [m] are as `Links.ends` has them.
    """
    made = Means(np.empty(obstacles.shape), np.empty(obstacles.shape), np.empty(obstacles.shape))
    for e in range(obstacles.shape[0]):
        for link in range(obstacles.shape[1]):
            x, y = start[e, link, 0] - end[e, link, 0], start[e, link, 1] - end[e, link, 1]
            z = start[e, link, 2] - end[e, link, 2]
            squared_m, gain_db = x * x + y * y + z * z, 0.0
            made.loss_db[e, link] = equations.path_loss_db(table, squared_m, obstacles[e, link])
            if panel[link] >= 0:
                facing = heading[e, panel[link]]
                ahead = math.cos(facing) * x + math.sin(facing) * y
                gain_db = equations.element_gain_db(table, ahead / max(math.sqrt(squared_m), 1e-12))
            made.gain[e, link] = equations.db_to_linear(gain_db - made.loss_db[e, link])
            made.k_factor[e, link] = 0.0 if obstacles[e, link] > 0 else table.rician_k
    return made


def uniform_linear_array(centre: FloatArray, axis: FloatArray, count: int, spacing_m: float) -> FloatArray:
    """Positions [..., count, 3] [m] of antennas along the unit vectors `axis` [..., 3] around `centre` [..., 3] [m]."""
    steps = np.arange(count) - (count - 1) / 2
    return centre[..., None, :] + spacing_m * steps[:, None] * axis[..., None, :]


@compiled
def panel_elements(centre: FloatArray, heading: FloatArray, sizes: IntArray, spacing_m: float) -> FloatArray:
    """Positions of all elements [E, N, 3] [m] of vertical panels, panel by panel, row by row from the bottom.

    `centre` [E, S, 3] [m] are the panels' middles, `heading` [E, S] [rad] the horizontal directions that they face, and
    `sizes` [S, 2] their rows and columns.
    """
    places = np.empty((len(centre), (sizes[:, 0] * sizes[:, 1]).sum(), 3))
    for e in range(len(centre)):
        n = 0
        for s in range(len(sizes)):
            x, y = -math.sin(heading[e, s]), math.cos(heading[e, s])
            for row in range(sizes[s, 0]):
                for column in range(sizes[s, 1]):
                    along_row = spacing_m * (column - (sizes[s, 1] - 1) / 2)
                    places[e, n, 0] = centre[e, s, 0] + x * along_row
                    places[e, n, 1] = centre[e, s, 1] + y * along_row
                    places[e, n, 2] = centre[e, s, 2] + spacing_m * (row - (sizes[s, 0] - 1) / 2)
                    n += 1
    return places


def channels(
    links: Links,
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    counts: IntArray,
    mean: Means,
    diffuse: ComplexArray,
    wavelength_m: float,
) -> Channels:
    """Channels of E cells with K users, M antennas and N elements, of which every panel has `counts` [S].

    `antennas` [E, M, 3], `receivers` [E, K, 3] and `elements` [E, N, 3] are places [m], so that every entry has the
    phase exp(-j 2π d / λ) of its own distance: spherical waves. `diffuse` [E, K M + N M + K N] is the diffuse part of
    h_d, G and h_r, of unit mean power.
    """
    cells, users, rows, columns = len(receivers), receivers.shape[1], elements.shape[1], antennas.shape[1]
    made = Channels(
        np.empty((cells, users, columns), np.complex128),
        np.empty((cells, rows, columns), np.complex128),
        np.empty((cells, users, rows), np.complex128),
    )
    gain, k_factor = links.split(mean.gain), links.split(mean.k_factor)
    _fill(made, antennas, receivers, elements, counts, gain, k_factor, diffuse, wavelength_m)
    return made


@compiled
def _fill(
    made: Channels,
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    counts: IntArray,
    gain: tuple[FloatArray, FloatArray, FloatArray],
    k_factor: tuple[FloatArray, FloatArray, FloatArray],
    diffuse: ComplexArray,
    wavelength_m: float,
) -> None:
    users, columns = receivers.shape[1], antennas.shape[1]
    away = np.empty(elements.shape[1] * columns)
    for e in range(len(receivers)):
        at = 0
        for k in range(users):
            _distances(receivers[e, k : k + 1], antennas[e], wavelength_m, away)
            at = _fill_link(made.direct[e, k], away, gain[0][e, k], k_factor[0][e, k], diffuse[e], at)
        first = 0
        for s in range(len(counts)):
            own = slice(first, first + counts[s])
            _distances(elements[e, own], antennas[e], wavelength_m, away)
            entries = made.incident[e, own].ravel()
            at = _fill_link(entries, away, gain[1][e, s], k_factor[1][e, s], diffuse[e], at)
            first += counts[s]
        for k in range(users):
            first = 0
            for s in range(len(counts)):
                own = slice(first, first + counts[s])
                _distances(receivers[e, k : k + 1], elements[e, own], wavelength_m, away)
                entries = made.reflected[e, k, own]
                at = _fill_link(entries, away, gain[2][e, s, k], k_factor[2][e, s, k], diffuse[e], at)
                first += counts[s]


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
    entries: ComplexArray, away: FloatArray, gain: float, k_factor: float, diffuse: ComplexArray, at: int
) -> int:
    """Write all entries [n] of a link, with their diffuse parts from `at` on; where those end.

    Eq. (PL) with Rician fading h = √(κ/(κ+1)) h_LoS + √(1/(κ+1)) h_diffuse; κ = 0 is Rayleigh's.
    """
    scattered = math.sqrt(gain / (k_factor + 1))
    los = math.sqrt(k_factor) * scattered
    for entry in range(len(entries)):
        entries[entry] = los * vectors.phasor(away[entry]) + scattered * diffuse[at + entry]
    return at + len(entries)
