"""What agents' numbers are scaled by, so that they are of order one at any carrier, bandwidth and noise."""

import math

from mjris.config import Config
from mjris.radio.equations import path_loss_db
from mjris.radio.tables import LinkTable

_DISTANCE_M = 10.0
"""What is usual indoors."""


def rate_unit_bps(config: Config) -> float:
    """The unit of rewards and of rates that are observed [bit/s].

    The power of ten nearest to the sum rate V B log2(1 + M P / (V σ²) 10^(-L/10)) in line of sight at 10 m: 1 Mb/s with
    the paper's numbers.
    """
    radio = config.radio
    loss_db = path_loss_db(LinkTable.of(radio), _DISTANCE_M**2, 0)
    snr = radio.num_antennas * radio.tx_power_w / (radio.num_clusters * radio.noise_w) * 10 ** (-loss_db / 10)
    return 10.0 ** round(math.log10(radio.num_clusters * radio.bandwidth_hz * math.log2(1 + snr)))


def usual_loss_db(config: Config) -> float:
    """Path loss around which others lie [dB]: at 10 m, half way from line of sight to behind one obstacle."""
    table = LinkTable.of(config.radio)
    clear_db, blocked_db = (path_loss_db(table._replace(materials=False), _DISTANCE_M**2, n) for n in (0, 1))
    return (clear_db + blocked_db) / 2
