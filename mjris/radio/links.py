"""The links of a slot, from where everything stands: path losses, mean amplitudes, and the channels of all entries."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit import vectors
from mjris.jit.compiled import compiled, inlined
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

    def __init__(self, users: int, elements: IntArray):
        """`elements` [S] are those of every panel."""
        panels, self.elements = len(elements), elements
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

    def of_entries(self, antennas: int) -> tuple[IntArray, IntArray, IntArray]:
        """The links of all entries of h_d [K, M], G [N, M] and h_r [K, N]."""
        users, panel_of = self.direct.stop, np.repeat(np.arange(len(self.elements)), self.elements)
        return (
            np.repeat(np.arange(users)[:, None], antennas, 1),
            np.repeat(self.incident.start + panel_of[:, None], antennas, 1),
            self.reflected.start + users * panel_of + np.arange(users)[:, None],
        )

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
    obstacles: FloatArray,
    heading: FloatArray,
) -> Means:
    """`Means` of links [E, L], for panels [L] that face `heading` [E, S] [rad].

    With `obstacles` in their way, counted or in dB as the table has them.
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
            made.k_factor[e, link] = equations.rician_k(table, obstacles[e, link])
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
    mean: Means,
    diffuse: ComplexArray,
    wavelength_m: float,
) -> Channels:
    """Channels of E cells with K users, M antennas and N elements.

    `antennas` [E, M, 3], `receivers` [E, K, 3] and `elements` [E, N, 3] are places [m], so that every entry has the
    phase exp(-j 2π d / λ) of its own distance: spherical waves. `diffuse` [E, K M + N M + K N] is the diffuse part of
    h_d, G and h_r, of unit mean power.
    """
    cells, users, rows, columns = len(receivers), receivers.shape[1], elements.shape[1], antennas.shape[1]
    direct = np.empty((cells, users, columns), np.complex128)
    incident = np.empty((cells, rows, columns), np.complex128)
    reflected = np.empty((cells, users, rows), np.complex128)
    places = antennas, receivers, elements
    gain, k_factor, parts = mean.gain, mean.k_factor, (direct, incident, reflected)
    _fill(*parts, *places, links.person, links.panel, links.elements, gain, k_factor, diffuse, 1 / wavelength_m)
    return Channels(direct, incident, reflected)


@compiled
def _fill(
    direct: ComplexArray,
    incident: ComplexArray,
    reflected: ComplexArray,
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    person: IntArray,
    panel: IntArray,
    counts: IntArray,
    gain: FloatArray,
    k_factor: FloatArray,
    diffuse: ComplexArray,
    per_m: float,
) -> None:
    columns, rows = antennas.shape[1], elements.shape[1]
    los, first = np.empty((2, max(rows, columns))), counts.cumsum() - counts
    # Where the parts of G and h_r begin among the diffuse ones.
    to_elements, to_users = direct[0].size, direct[0].size + incident[0].size
    for e in range(len(receivers)):
        of_antennas, of_elements = antennas[e].T.copy(), elements[e].T.copy()
        for link in range(len(person)):
            k, s = int(person[link]), int(panel[link])
            scattered = math.sqrt(gain[e, link] / (k_factor[e, link] + 1))
            specular = math.sqrt(k_factor[e, link]) * scattered
            if s < 0:
                _phasors(receivers[e, k], of_antennas, 0, columns, per_m, los)
                for m in range(columns):
                    direct[e, k, m] = _entry(specular, los, m, scattered, diffuse[e, k * columns + m])
                continue
            begin, count = int(first[s]), int(counts[s])
            if k < 0:
                for m in range(columns):
                    _phasors(antennas[e, m], of_elements, begin, count, per_m, los)
                    for n in range(count):
                        scatter = diffuse[e, to_elements + (begin + n) * columns + m]
                        incident[e, begin + n, m] = _entry(specular, los, n, scattered, scatter)
            else:
                _phasors(receivers[e, k], of_elements, begin, count, per_m, los)
                for n in range(count):
                    scatter = diffuse[e, to_users + k * rows + begin + n]
                    reflected[e, k, begin + n] = _entry(specular, los, n, scattered, scatter)


@inlined
def _entry(specular: float, los: FloatArray, n: int, scattered: float, diffuse: complex) -> complex:
    """Eq. (PL): √gain (√(κ/(κ+1)) h_LoS + √(1/(κ+1)) h_diffuse), where κ = 0 is Rayleigh's."""
    return complex(specular * los[0, n] + scattered * diffuse.real, specular * los[1, n] + scattered * diffuse.imag)


@compiled
def _phasors(end: FloatArray, places: FloatArray, first: int, count: int, per_m: float, los: FloatArray) -> None:
    """Write e^{-2πi d/λ} of the distances from an end [3] to some places of [3, n] [m] to `los` [2, ≥ count]."""
    x, y, z = places[0, first : first + count], places[1, first : first + count], places[2, first : first + count]
    for n in range(count):
        to_x, to_y, to_z = end[0] - x[n], end[1] - y[n], end[2] - z[n]
        turned = vectors.phasor(math.sqrt(to_x * to_x + to_y * to_y + to_z * to_z) * per_m)
        los[0, n], los[1, n] = turned.real, turned.imag
