"""The radio map: what a place is worth to the RIS, predicted from the layout and where the users stand."""

import numpy as np
from numpy.typing import NDArray

from mjris.radio import channel, prediction, propagation
from mjris.simulator import Simulator

FloatArray = NDArray[np.floating]


def link_gains(simulator: Simulator, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power gains of AP–RIS [E, P] and RIS–users [E, P, K] for panels at `places` [E, P, 2] [m], patterns included.

    Obstacles are those of the `sight_map`, distances exact. The panel faces the bisector of AP and users, as the pan
    motor would turn it.
    """
    config, world = simulator.config, simulator.world
    receivers = world.receivers()
    height = np.full((*places.shape[:2], 1), config.world.panel_height_m)
    panels = np.concatenate([places, height], -1)
    ends = np.concatenate([receivers, simulator.ap_position[:, None]], 1)
    toward = ends[:, None] - panels[:, :, None]
    x, y, z = (toward[..., axis] for axis in range(3))
    users = world.sight_map.between(receivers[..., :2], places)
    blockers = np.concatenate([users, world.sight_map.from_ap(places)[..., None]], -1)
    loss_db = propagation.path_loss_db(np.sqrt(x * x + y * y + z * z), blockers, config.radio.carrier_hz)
    normal = channel.panel_normal(simulator.bisector(places))[:, :, None]
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


def best_goals(simulator: Simulator, horizon_slots: int = 30) -> tuple[FloatArray, FloatArray]:
    """Where to drive [E, 2] [m] for the largest predicted sum over the next slots, and the mean of that [E] [bit/s].

    Of every other node of `World.paths` and the present place, for users who stay where they are. On the way the
    value is taken to change evenly.
    """
    world, paths = simulator.world, simulator.world.paths
    here = world.fleet.xy
    nodes = paths.nodes[paths.coarse]
    places = np.concatenate([here[:, None], np.broadcast_to(nodes, (len(here), *nodes.shape))], 1)
    values = place_values(simulator, places)
    reach = world.config.max_speed_mps * world.config.slot_s
    slots = np.minimum(paths.distance_to_nodes(here)[:, paths.coarse] / reach, horizon_slots)
    slots = np.concatenate([np.zeros((len(here), 1)), slots], 1)
    total = slots * (values[:, :1] + values) / 2 + (horizon_slots - slots) * values
    cells, best = np.arange(len(here)), total.argmax(1)
    return places[cells, best], total[cells, best] / horizon_slots


def penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> FloatArray:
    """Sum rate [...] of rates [..., K] [bit/s], divided by λ where any user misses QoS, eq. (R)."""
    total = rates_bps.sum(-1)
    return np.where((rates_bps >= qos_bps).all(-1), total, total / penalty)
