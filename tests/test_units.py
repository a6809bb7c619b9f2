"""Units of rewards and observations."""

from dataclasses import replace

import pytest

from mjris.config import Radio, preset
from mjris.simulation.units import rate_unit_bps, usual_loss_db


@pytest.mark.parametrize(
    ("name", "radio", "unit_bps"),
    [
        ("paper", {}, 1e6),  # 2 MHz · log2(1 + 2 · 0.1 W / 1 µW · 10^-5.57) = 1.2 Mb/s
        ("classic", {"bandwidth_hz": 1e8, "noise_dbm_per_mhz": -50.0}, 1e8),
        ("office", {}, 1e10),  # 800 MHz · log2(1 + 4 · 5 mW / 8 pW · 10^-6.97) = 6.5 Gb/s
    ],
)
def test_the_unit_is_of_the_order_of_a_sum_rate_in_sight(name, radio, unit_bps):
    config = preset(name)
    assert rate_unit_bps(replace(config, radio=replace(config.radio, **radio))) == unit_bps


def test_the_usual_loss_by_hand():
    # 2 GHz: 20 log10(2000) = 66.0206; 16.9 - 27.2 + 66.0206 in sight, 66.0206 - 28 + 25.5 + 15 behind one obstacle.
    assert usual_loss_db(replace(preset("paper"), radio=Radio())) == pytest.approx((55.7206 + 78.5206) / 2, abs=1e-4)
