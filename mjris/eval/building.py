"""Cells stacked as floors: which band each floor has, and what leaks in from floors on the same band."""

import math

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mjris.config import Config, ConfigError, Radio, w_to_dbm
from mjris.eval.floormap import FloorMap, rate_bps
from mjris.radio import propagation
from mjris.world.office import Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


def band_plan(num_floors: int, num_bands: int) -> IntArray:
    """Band of every floor [num_floors]; floors take the bands in turn (section II of the paper).

    Raises `ConfigError` where adjacent floors would have to share a band.
    """
    if num_floors < 1:
        raise ConfigError(f"floors: {num_floors} is not allowed: a building has at least 1")
    least = min(num_floors, 2)
    if num_bands < least:
        raise ConfigError(
            f"bands: {num_bands} is not allowed: for {num_floors} floors it must be at least {least}, "
            "so that adjacent floors differ"
        )
    return np.arange(num_floors) % num_bands


def storey_height_m(office: Office, slab_m: float) -> float:
    """From floor to floor [m]: the room and the slab above it. Raises `ConfigError` for a slab of no thickness."""
    if not 0 <= slab_m < math.inf:
        raise ConfigError(f"slab_m: {slab_m:g} is not allowed: it must be a thickness of at least 0 m")
    return office.layout.room.size[2] + slab_m


def leakage_w(
    receivers_m: FloatArray, ap_m: FloatArray, floors_up: IntArray, storey_m: float, radio: Radio
) -> FloatArray:
    """Mean power [A, ...] [W] that receivers [..., 3] [m] get from APs `floors_up` [A] floors up, negative for down.

    Those APs hang at `ap_m` [3] [m] of their own floor and send P_max with beams that know nothing of the receiver,
    so without array gain. Each floor crossed counts as an obstacle of the link table; furniture on the
    way is left out, which errs on the high side.
    """
    floors = np.asarray(floors_up).reshape(-1, *[1] * (receivers_m.ndim - 1))
    rise = floors[..., None] * storey_m * np.array([0.0, 0.0, 1.0])
    distance = np.linalg.norm(ap_m + rise - receivers_m, axis=-1)
    loss_db = propagation.path_loss_db(distance, np.abs(floors), radio.carrier_hz, radio.link_table)
    return radio.tx_power_w * propagation.db_to_linear(-loss_db)


def leakage_table(floor: FloorMap, config: Config, storey_m: float, num_bands: int) -> pd.DataFrame:
    """What a floor in the middle gets from the APs n floors above and n floors below, one row for each n.

    Over all places where a user can stand: interference in the mean and at worst [dBm], the same over noise (INR) [dB],
    and the share of the rate that a single user without RIS loses, of the mean rate and at worst [%]. `same_band` says
    whether the band plan of `config.federation.num_cells` floors, `storey_m` [m] high, puts the two on one band.
    Raises `ConfigError` for a single floor or a bad plan.
    """
    radio, num_floors = config.radio, config.federation.num_cells
    if num_floors < 2:
        raise ConfigError(f"federation.num_cells: {num_floors} is not allowed: leakage takes at least 2 floors")
    plan = band_plan(num_floors, num_bands)
    free = ~floor.in_furniture
    xy = np.stack(np.meshgrid(floor.x_m, floor.y_m), -1)[free]
    receivers = np.concatenate([xy, np.full((len(xy), 1), config.world.user_height_m)], -1)
    apart = np.arange(1, num_floors)
    above, below = (leakage_w(receivers, floor.ap_xyz_m, side * apart, storey_m, radio) for side in (1, -1))
    interference = above + below
    snr = propagation.db_to_linear(floor.snr_db[free])
    quiet = rate_bps(snr, radio)
    loud = rate_bps(snr / (1 + interference / radio.noise_w), radio)
    mean_dbm, worst_dbm = (10 * np.log10(power * 1e3) for power in (interference.mean(1), interference.max(1)))
    noise_dbm = w_to_dbm(radio.noise_w)
    return pd.DataFrame(
        {
            "floors_apart": apart,
            "same_band": plan[apart] == plan[0],
            "noise_dbm": noise_dbm,
            "interference_dbm": mean_dbm,
            "interference_worst_dbm": worst_dbm,
            "inr_db": mean_dbm - noise_dbm,
            "inr_worst_db": worst_dbm - noise_dbm,
            "rate_lost_percent": 100 * (1 - loud.sum(1) / quiet.sum()),
            "rate_lost_worst_percent": 100 * (1 - loud / quiet).max(1),
        }
    )
