"""Random channels, and the radio's functions with the arguments that most tests have for them."""

import numpy as np

from mjris.radio import closed_forms, powers, surface
from mjris.radio.fading import complex_normal
from mjris.radio.links import Channels
from mjris.radio.serving import System
from mjris.radio.surface import Surface


def random_channels(rng, batch=(3,), users=4, antennas=4, elements=16) -> Channels:
    shapes = ((users, antennas), (elements, antennas), (users, elements))
    return Channels(*(complex_normal(rng, (*batch, *shape)) for shape in shapes))


CLUSTERS = np.array([[0, 3], [2, 1]])


def random_clusters(rng, num_clusters, size):
    return rng.permutation(num_clusters * size).reshape(num_clusters, size)


def system(scheme, tx_power_w, bandwidth_hz, noise_w, qos_bps, clusters=CLUSTERS, selects=False) -> System:
    return System(np.asarray(clusters), scheme == "oma", tx_power_w, bandwidth_hz, noise_w, qos_bps, selects)


def effective_channel(channels, phases, amplitude=1.0):
    return surface.effective_channel(Surface(amplitude), channels, phases)


def aligned_phases(channels, weights=None, iterations=3):
    return closed_forms.aligned_phases(Surface(1.0), channels, weights, iterations)


def qos_aligned_phases(served: System, channels, weights=None, order=None, iterations=7):
    return closed_forms.qos_aligned_phases(served, Surface(1.0), channels, weights, order, iterations)


def qos_first_powers(channel, clusters, tx_power_w, bandwidth_hz, noise_w, qos_bps, order=None):
    """For NOMA, where every cluster spends its share."""
    served = system("noma", tx_power_w, bandwidth_hz, noise_w, qos_bps, clusters)
    budgets = np.full(len(served.clusters), tx_power_w / len(served.clusters))
    return powers.qos_first_powers(served, channel, budgets, order)
