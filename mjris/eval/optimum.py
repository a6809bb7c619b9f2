"""Reference optimum of a slot: the best phases and powers that a search from many starts finds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.radio.ascent import Effort, ascended_phases
from mjris.radio.links import Channels
from mjris.radio.powers import best_powers
from mjris.radio.serving import System, flat, rates
from mjris.radio.surface import Surface, effective_channel, flattened

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

EFFORT = Effort(choices=16, variants=3, screening=8, finalists=8, steps=40, sweeps=2)
_RANDOM_STARTS = 2


@dataclass(frozen=True)
class Optimum:
    """The best known solution of every slot."""

    phases_rad: FloatArray
    """[..., N] [rad]"""
    powers_w: FloatArray
    """[..., K] [W]"""
    rates_bps: FloatArray
    """[..., K] [bit/s]"""


def best_known(
    channels: Channels,
    clusters: IntArray,
    radio: Radio,
    qos_bps: float,
    rng: np.random.Generator,
    order: IntArray | None = None,
    effort: Effort = EFFORT,
) -> Optimum:
    """The highest sum rate known for every slot, over all phases and all powers that `radio` allows.

    `channels` have the leading axes [...] of the slots, `clusters` are int [V, K/V]. A solution in which every user
    has `qos_bps` beats one in which somebody has not; among equals the sum rate decides. Users are decoded in a given
    `order` [..., V, K/V] or, where that is None or negative, in that of the slot's gains. This is the best of a search,
    `ascended_phases` with far more starts and steps than a task can afford, not a proven optimum; `mjris.eval.bound`
    has what nothing can exceed.
    """
    return search(System.of(radio, clusters, qos_bps), Surface.of(radio), channels, rng, order, effort)


def search(
    system: System,
    surface: Surface,
    channels: Channels,
    rng: np.random.Generator,
    order: IntArray | None = None,
    effort: Effort = EFFORT,
) -> Optimum:
    """`best_known` for a system and a surface."""
    batch, links = channels.direct.shape[:-2], flattened(channels)
    slots, elements = links.incident.shape[:2]
    given = None if order is None else flat(order, 2)
    random = rng.uniform(-np.pi, np.pi, (slots, _RANDOM_STARTS, elements))
    phases = ascended_phases(system, surface, links, effort, None, given, random)
    effective = effective_channel(surface, links, phases)
    powers = best_powers(system, effective, given)
    found = rates(system, effective, powers, given)
    return Optimum(*(values.reshape(*batch, -1) for values in (phases, powers, found)))
