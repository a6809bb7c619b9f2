from dataclasses import replace

import literal
import numpy as np
import pytest

from mjris.config import preset
from mjris.planning.prediction import predicted_rates
from mjris.radio.beams import cluster_beams
from mjris.radio.fading import complex_normal
from mjris.radio.serving import System

RADIO = preset("classic").radio
CLUSTERS = np.array([[0, 1], [2, 3]])
QOS_BPS = 10e3


def test_beams_have_the_mean_gains_that_the_prediction_takes():
    """Over Rayleigh fading, with users of a cluster whose strengths are far apart."""
    strength = np.array([1.0, 1e3, 1e2, 1.0])
    channel = np.sqrt(strength)[:, None] * complex_normal(np.random.default_rng(0), (40_000, 4, 4))
    beams = np.stack([cluster_beams(slot, CLUSTERS) for slot in channel])
    mean = (np.abs((channel * beams).sum(-1)) ** 2).mean(0) / strength
    np.testing.assert_allclose(mean, [1, 3, 3, 1], rtol=0.03)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_rates_are_those_worked_out_by_hand(scheme):
    rng = np.random.default_rng(1)
    for _ in range(20):
        direct, reflected = 10 ** rng.uniform(-9, -5, (2, 4))
        incident = 10 ** rng.uniform(-7, -4)
        radio = replace(RADIO, scheme=scheme)
        found = predicted_rates(direct, np.array(incident), reflected, CLUSTERS, radio, qos_bps=QOS_BPS)
        served = System.of(radio, CLUSTERS, QOS_BPS)
        expected = literal.predicted_rates(served, radio, direct, [(radio.num_elements, incident, reflected)])
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)
