"""The radio map: what a place is worth to the RIS, predicted from the layout and where the users stand."""

import numpy as np
from numpy.typing import NDArray

from mjris.radio import channel, prediction, propagation
from mjris.simulator import Simulator

FloatArray = NDArray[np.floating]


def link_gains(simulator: Simulator, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power gains of AP–RIS [E, P] and RIS–users [E, P, K] for panels at `places` [E, P, 2] [m], patterns included.

    The panel faces the bisector of AP and users, as the pan motor would turn it.
    """
    config, world = simulator.config, simulator.world
    receivers = world.receivers()
    cells, num_places = places.shape[:2]
    num_users = receivers.shape[1]
    height = np.full((cells, num_places, 1), config.world.panel_height_m)
    panels = np.concatenate([places, height], -1)
    ends = np.concatenate([receivers, simulator.ap_position[:, None]], 1)
    start = np.broadcast_to(ends[:, None], (cells, num_places, num_users + 1, 3))
    end = np.broadcast_to(panels[:, :, None], start.shape)
    own = np.tile(np.append(world.office(0).person_bodies, -1), num_places)
    blockers = world.sight.blockers(start.reshape(cells, -1, 3), end.reshape(cells, -1, 3), own)
    toward = start - end
    distance = np.sqrt((toward * toward).sum(-1))
    loss_db = propagation.path_loss_db(distance, blockers.reshape(distance.shape), config.radio.carrier_hz)
    heading = simulator.bisector(places)
    normal = channel.panel_normal(heading)[:, :, None]
    pattern = channel.element_gain(config.radio.element_pattern, config.radio.element_exponent, normal, toward)
    gain = propagation.db_to_linear(-loss_db) * pattern
    return gain[..., -1], gain[..., :-1]


def place_values(simulator: Simulator, places: FloatArray) -> FloatArray:
    """Predicted sum rate with the QoS penalty, [E, P] [bit/s], with the RIS at `places` [E, P, 2] [m]."""
    config = simulator.config
    num_users = config.world.num_users
    incident, reflected = link_gains(simulator, places)
    direct = propagation.db_to_linear(-simulator.scene.path_loss_db[:, None, :num_users])
    direct = np.broadcast_to(direct, reflected.shape)
    rates = prediction.predicted_rates(
        direct, incident, reflected, simulator.clusters, config.radio, config.task.qos_bps
    )
    return penalised(rates, config.task.qos_bps, config.task.qos_penalty)


def penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> FloatArray:
    """Sum rate [...] of rates [..., K] [bit/s], divided by λ where any user misses QoS, eq. (R)."""
    total = rates_bps.sum(-1)
    return np.where((rates_bps >= qos_bps).all(-1), total, total / penalty)
