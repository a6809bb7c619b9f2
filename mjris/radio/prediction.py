"""What the RIS would give at a place, predicted from geometry alone: mean amplitudes, no fading, no interference."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.config import Radio
from mjris.radio.decoding import cancelled, needed_share, qos_first, sort_users
from mjris.radio.serving import System

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class Arrays(NamedTuple):
    """The antennas and the panel."""

    antennas: int
    elements: int
    amplitude: float
    """Modulus of an element's coefficient."""

    @classmethod
    def of(cls, radio: Radio) -> "Arrays":
        """With the numbers of a config."""
        return cls(radio.num_antennas, radio.num_elements, radio.element_amplitude)


class Workspace(NamedTuple):
    """What a prediction fills, one place after another."""

    rates: FloatArray
    """[K] [bit/s]: what was predicted."""
    gains: FloatArray
    """[K]"""
    powers: FloatArray
    """[K] [W]"""
    needed: FloatArray
    """`needed_share` of QoS [K]."""
    order: IntArray
    """[V, K/V]"""


def predicted_rates(
    direct: FloatArray, incident: FloatArray, reflected: FloatArray, clusters: IntArray, radio: Radio, qos_bps: float
) -> FloatArray:
    """Rates [..., K] [bit/s] under QoS-first powers.

    `direct` [..., K], `incident` [...] and `reflected` [..., K] are power gains of the links AP–user, AP–RIS and
    RIS–user, element patterns included. A beam is made for the strongest user of its cluster, less the dimensions that
    the other clusters' take, so that its mean gain is M - V + 1 times that of one antenna; to the others in the cluster
    it is a beam in a random direction. With OMA every user has a beam. The panel is shared by clusters, of which each
    has N/V elements in phase for the user that counts, and the other elements add up at random. Clusters are taken as
    perfectly separated.
    """
    shape = (-1, direct.shape[-1])
    rates = _predict_all(
        System.of(radio, clusters, qos_bps),
        Arrays.of(radio),
        np.ascontiguousarray(direct).reshape(shape),
        np.ascontiguousarray(incident).reshape(-1),
        np.ascontiguousarray(reflected).reshape(shape),
    )
    return rates.reshape(direct.shape)


@compiled
def _predict_all(
    system: System, arrays: Arrays, direct: FloatArray, incident: FloatArray, reflected: FloatArray
) -> FloatArray:
    rates, work = np.empty(direct.shape), workspace(system)
    for place in range(len(direct)):
        predict(system, arrays, direct[place], incident[place], reflected[place], work)
        rates[place] = work.rates
    return rates


@compiled
def workspace(system: System) -> Workspace:
    """Where predictions can be worked out."""
    users = system.clusters.size
    needed = np.full(users, needed_share(system.bandwidth_hz, system.qos_bps))
    return Workspace(np.empty(users), np.empty(users), np.empty(users), needed, np.empty_like(system.clusters))


@compiled
def predict(
    system: System, arrays: Arrays, direct: FloatArray, incident: float, reflected: FloatArray, work: Workspace
) -> None:
    """`predicted_rates` of one place."""
    # To read an array from a tuple costs as much as a square root.
    rates, gains, powers, needed, order = work
    num_clusters, bands = system.clusters.shape
    users, beam_gain, in_phase = len(direct), arrays.antennas - num_clusters + 1, arrays.elements / num_clusters
    for k in range(users):
        one_element = math.sqrt(incident * reflected[k]) * arrays.amplitude
        coherent = math.sqrt(direct[k]) + in_phase * one_element
        gains[k] = (coherent**2 + (arrays.elements - in_phase) * one_element**2) / system.noise_w
    if system.oma:
        # A user has K/V of a cluster's bands' noise, and P/K of the power.
        for k in range(users):
            snr = beam_gain * gains[k] * bands * system.tx_power_w / users
            rates[k] = system.bandwidth_hz / bands * math.log1p(snr) / math.log(2)
    else:
        sort_users(system.clusters, gains, order)
        for v in range(num_clusters):
            gains[order[v, -1]] *= beam_gain
        qos_first(gains, order, system.tx_power_w / num_clusters, needed, powers)
        cancelled(system.bandwidth_hz, gains, powers, order, rates)
