"""What cells know of their channels and of where users stand, drawn anew for every slot."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.radio import fading, knowledge, links
from mjris.radio.links import Channels, Links, Means
from mjris.simulation.streams import Streams

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_STRAIGHT_K = 1e12
"""Rician factor of links that are taken for their straight path alone."""


class Places(NamedTuple):
    """Where links end, in E cells."""

    antennas: FloatArray
    """[E, M, 3] [m]"""
    receivers: FloatArray
    """[E, K, 3] [m]"""
    panels: FloatArray
    """Their middles [E, S, 3] [m]."""
    headings: FloatArray
    """Where panels face [E, S] [rad]."""


class Knowing:
    """The knowledge of E cells; see `config.Knowledge`."""

    def __init__(
        self, config: Config, of: Links, entries: tuple[IntArray, IntArray, IntArray], sizes: IntArray, streams: Streams
    ):
        """For links, the links of all entries of h_d, G and h_r, and the panels' rows and columns [S, 2]."""
        self._what, self._radio = config.radio.knowledge, config.radio
        self._slot_s = config.world.slot_s
        self._all_is_known = self._what.perfect and self._what.position_error_m == 0
        self._links, self._sizes, self._streams = of, sizes, streams
        self._shapes = [part.shape for part in entries]
        self._entries = np.concatenate([part.ravel() for part in entries])
        cells, users = streams.num_cells, config.world.num_users
        self._offset_m = np.zeros((cells, users, 2))
        self._innovation = np.zeros((cells, len(self._entries)), np.complex128)
        self._error = np.zeros_like(self._innovation)
        self._before: Places | None = None
        """Where things were as the slot began."""

    def draw(self, cells: IntArray) -> None:
        """Draw what some cells [n] are wrong about."""
        what = self._what
        if self._all_is_known:
            return
        for e, rng in zip(cells, self._streams.knowledge(cells), strict=True):
            if what.position_error_m > 0:
                self._offset_m[e] = rng.normal(0, what.position_error_m, self._offset_m.shape[1:])
            if what.age_s > 0:
                self._innovation[e] = fading.complex_normal(rng, self._innovation.shape[1:])
            if what.nmse_db is not None:
                self._error[e] = fading.complex_normal(rng, self._error.shape[1:])

    def begin(self, where: Callable[[], Places], cells: IntArray | None = None) -> None:
        """Begin a slot with things where they are, or in some cells [n] an episode, where nothing has moved yet."""
        if self._what.age_s == 0:
            return
        places = where()
        if self._before is None or cells is None:
            self._before = Places(*(part.copy() for part in places))
            return
        for kept, part in zip(self._before, places, strict=True):
            kept[cells] = part[cells]

    def users_xy(self, users_xy: FloatArray, room_m: FloatArray) -> FloatArray:
        """Where users are taken to be [E, K, 2] [m], in their rooms [E, 2] [m]."""
        if self._what.position_error_m == 0:
            return users_xy
        return np.clip(users_xy + self._offset_m, 0, room_m[:, None])

    def channels(
        self, true: Channels, mean: Means, diffuse: ComplexArray, now: Places, known_xy: FloatArray, share: float
    ) -> Channels:
        """What is known of `true` channels, whose links are `mean`, when a `share` of the slot is over since `begin`.

        With users taken to be at `known_xy` [E, K, 2] [m]. Path losses are known. Of channels that are old, phases and
        fading are those of then: from where things were when the same speed had led them here, with the correlation of
        `clarke` for what either end has moved.
        """
        what = self._what
        if what.perfect:
            return true
        if what.source == "positions":
            straight = mean._replace(k_factor=np.full_like(mean.k_factor, _STRAIGHT_K))
            receivers = np.concatenate([known_xy, now.receivers[..., 2:]], -1)
            return self._made(straight, np.zeros_like(diffuse), now._replace(receivers=receivers))
        known = true
        if what.age_s > 0 and self._before is not None:
            back = min(what.age_s / (share * self._slot_s), 1.0)
            then = _between(now, self._before, back)
            moved = knowledge.clarke(self._moved_m(now, then), self._radio.wavelength_m)
            old = knowledge.aged(diffuse, self._innovation, moved[:, self._entries])
            known = self._made(mean, old, then)
        if what.nmse_db is not None:
            gains = self._split(mean.gain[:, self._entries])
            known = knowledge.estimated(known, self._split(self._error), gains, 10 ** (what.nmse_db / 10))
        return known

    def _made(self, mean: Means, diffuse: ComplexArray, places: Places) -> Channels:
        """The channels of links like `mean` between places."""
        wavelength_m = self._radio.wavelength_m
        elements = links.panel_elements(places.panels, places.headings, self._sizes, wavelength_m / 2)
        return links.channels(self._links, places.antennas, places.receivers, elements, mean, diffuse, wavelength_m)

    def _moved_m(self, now: Places, then: Places) -> FloatArray:
        """How far the ends of links have moved, both together [E, L] [m]."""
        users = np.linalg.norm(now.receivers - then.receivers, axis=-1)
        panels = np.linalg.norm(now.panels - then.panels, axis=-1)
        of, nobody = self._links, np.zeros((len(users), 1))
        # Person and panel -1, who is none, is the last one.
        ends = np.concatenate([users, nobody], 1)[:, of.person], np.concatenate([panels, nobody], 1)[:, of.panel]
        return np.hypot(*ends)

    def _split(self, flat: np.ndarray) -> Channels:
        """Entries [E, K M + N M + K N] as those of h_d, G and h_r."""
        sizes = np.cumsum([math.prod(shape) for shape in self._shapes])[:-1]
        parts = np.split(flat, sizes, 1)
        return Channels(*(part.reshape(-1, *shape) for part, shape in zip(parts, self._shapes, strict=True)))


def _between(now: Places, before: Places, back: float) -> Places:
    """Where things were a share of the way back from `now` to `before`."""
    turned = np.angle(np.exp(1j * (before.headings - now.headings)))
    antennas, receivers, panels = (
        here + back * (there - here) for here, there in zip(now[:3], before[:3], strict=True)
    )
    return Places(antennas, receivers, panels, now.headings + back * turned)
