import math
from dataclasses import replace

import numpy as np
import pytest

from mjris.config import preset
from mjris.planning.prediction import predicted_rates
from mjris.radio.beams import cluster_beams
from mjris.radio.fading import complex_normal

RADIO = preset("office").radio
CLUSTERS = np.array([[0, 1], [2, 3]])
QOS_BPS = 10e3


def test_beams_have_the_mean_gains_that_the_prediction_takes():
    """Over Rayleigh fading, with users of a cluster whose strengths are far apart."""
    strength = np.array([1.0, 1e3, 1e2, 1.0])
    channel = np.sqrt(strength)[:, None] * complex_normal(np.random.default_rng(0), (40_000, 4, 4))
    beams = np.stack([cluster_beams(slot, CLUSTERS) for slot in channel])
    mean = (np.abs((channel * beams).sum(-1)) ** 2).mean(0) / strength
    np.testing.assert_allclose(mean, [1, 3, 3, 1], rtol=0.03)


def by_hand(direct, incident, reflected, scheme: str) -> list[float]:
    """Rates cluster by cluster, with loops, of M = 4 antennas, N = 16 elements and V = 2 clusters."""
    gains = []
    for k in range(4):
        element = math.sqrt(incident * reflected[k])
        gains.append(((math.sqrt(direct[k]) + 8 * element) ** 2 + 8 * element**2) / RADIO.noise_w)
    if scheme == "oma":
        return [0.5e6 * math.log2(1 + 3 * gain * 2 * RADIO.tx_power_w / 4) for gain in gains]
    rates = [0.0] * 4
    for users in ((0, 1), (2, 3)):
        weaker, stronger = sorted(users, key=lambda user: gains[user])
        weak, strong = gains[weaker], 3 * gains[stronger]
        budget = RADIO.tx_power_w / 2
        # (2^R - 1) = p e / ((budget - p) e + 1) solved for p
        share = 2 ** (QOS_BPS / 1e6) - 1
        power = share * (budget + 1 / weak) / (1 + share)
        power = power if power <= budget else 0
        rates[weaker] = 1e6 * math.log2(1 + power * weak / ((budget - power) * weak + 1))
        rates[stronger] = 1e6 * math.log2(1 + (budget - power) * strong)
    return rates


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_rates_are_those_worked_out_by_hand(scheme):
    rng = np.random.default_rng(1)
    for _ in range(20):
        direct, reflected = 10 ** rng.uniform(-9, -5, (2, 4))
        incident = 10 ** rng.uniform(-7, -4)
        found = predicted_rates(
            direct, np.array(incident), reflected, CLUSTERS, replace(RADIO, scheme=scheme), qos_bps=QOS_BPS
        )
        np.testing.assert_allclose(found, by_hand(direct, incident, reflected, scheme), rtol=1e-9, atol=1e-6)
