"""What the RIS would give at a place, predicted from geometry alone: mean amplitudes, no fading, no interference."""

import math

from mjris.config import Radio
from mjris.radio.control import qos_first_split
from mjris.radio.namespace import array_namespace
from mjris.radio.propagation import Array


def predicted_rates(
    direct: Array, incident: Array, reflected: Array, clusters: Array, radio: Radio, qos_bps: float
) -> Array:
    """Rates [..., K] [bit/s] under QoS-first powers, in the order of `clusters` int [V, K/V] read row by row.

    `direct` [..., K], `incident` [...] and `reflected` [..., K] are power gains of the links AP–user, AP–RIS and
    RIS–user, element patterns included. A beam is made for the strongest user of its cluster, less the dimensions that
    the other clusters' take, so that its mean gain is M - V + 1 times that of one antenna; to the others in the cluster
    it is a beam in a random direction. With OMA every user has a beam. The panel is shared by clusters, of which each
    has N/V elements in phase for the user that counts, and the other elements add up at random. Clusters are taken as
    perfectly separated.
    """
    xp = array_namespace(direct)
    n, v, k = radio.num_elements, radio.num_clusters, direct.shape[-1]
    one_element = xp.sqrt(incident[..., None] * reflected) * radio.element_amplitude
    coherent = xp.sqrt(direct) + n / v * one_element
    gains = (coherent**2 + (n - n / v) * one_element**2) / radio.noise_w
    gains = xp.take(gains, xp.reshape(clusters, (-1,)), axis=-1)
    beam_gain = radio.num_antennas - v + 1
    if radio.scheme == "oma":
        # A user has K/V of a cluster's bands' noise, and P/K of the power.
        share = clusters.shape[1]
        return radio.bandwidth_hz / share * xp.log1p(beam_gain * gains * share * radio.tx_power_w / k) / math.log(2)
    gains = xp.sort(xp.reshape(gains, (*gains.shape[:-1], *clusters.shape)), axis=-1)
    gains[..., -1] *= beam_gain
    budget = xp.full_like(gains[..., 0], radio.tx_power_w / v)
    powers = qos_first_split(gains, budget, radio.bandwidth_hz, qos_bps)
    later = xp.flip(xp.cumulative_sum(xp.flip(powers, axis=-1), axis=-1), axis=-1) - powers
    rates = radio.bandwidth_hz * xp.log1p(gains * powers / (gains * later + 1)) / math.log(2)
    return xp.reshape(rates, direct.shape)
