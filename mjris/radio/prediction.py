"""What the RIS would give at a place, predicted from geometry alone: mean amplitudes, no fading, no interference."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.config import Radio
from mjris.radio.serving import System, ascending, cancelled, qos_first

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


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
    rates = _predicted(
        System.of(radio, clusters, qos_bps),
        radio.num_antennas,
        radio.num_elements,
        radio.element_amplitude,
        np.ascontiguousarray(direct).reshape(shape),
        np.ascontiguousarray(incident).reshape(-1),
        np.ascontiguousarray(reflected).reshape(shape),
    )
    return rates.reshape(direct.shape)


@compiled
def _predicted(
    system: System,
    antennas: int,
    elements: int,
    amplitude: float,
    direct: FloatArray,
    incident: FloatArray,
    reflected: FloatArray,
) -> FloatArray:
    num_clusters, bands = system.clusters.shape
    users, beam_gain, in_phase = direct.shape[1], antennas - num_clusters + 1, elements / num_clusters
    rates, gains, least = np.empty(direct.shape), np.empty(users), np.full(users, system.qos_bps)
    for place in range(len(direct)):
        for k in range(users):
            one_element = math.sqrt(incident[place] * reflected[place, k]) * amplitude
            coherent = math.sqrt(direct[place, k]) + in_phase * one_element
            gains[k] = (coherent**2 + (elements - in_phase) * one_element**2) / system.noise_w
        if system.oma:
            # A user has K/V of a cluster's bands' noise, and P/K of the power.
            for k in range(users):
                snr = beam_gain * gains[k] * bands * system.tx_power_w / users
                rates[place, k] = system.bandwidth_hz / bands * math.log1p(snr) / math.log(2)
        else:
            order = ascending(system, gains)
            for v in range(num_clusters):
                gains[order[v, -1]] *= beam_gain
            powers = qos_first(system, gains, order, system.tx_power_w / num_clusters, least)
            rates[place] = cancelled(system, gains, powers, order)
    return rates
