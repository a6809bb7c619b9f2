"""The radio map: what a place is worth to the RIS, predicted from the layout and where the users stand."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.radio import channel, prediction, propagation
from mjris.simulator import Simulator

FloatArray = NDArray[np.floating]

_CHUNK = 4096
"""Places of all cells that are predicted together, which bounds the memory."""


def link_gains(simulator: Simulator, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power gains of AP–RIS [E, P] and RIS–users [E, P, K] for panels at `places` [E, P, 2] [m], patterns included.

    Obstacles are those of the `sight_map`, distances exact. The panel faces the bisector of AP and users, as the pan
    motor would turn it.
    """
    radio, world = simulator.config.radio, simulator.world
    receivers = world.receivers()
    ends = np.concatenate([receivers, simulator.ap_position[:, None]], 1)
    users = world.sight_map.between(receivers[..., :2], places)
    blockers = np.concatenate([users, world.sight_map.from_ap(places)[..., None]], -1)
    distance, cosine = _directions(
        ends, np.ascontiguousarray(places), world.config.panel_height_m, simulator.bisector(places)
    )
    loss_db = propagation.path_loss_db(distance, blockers, radio.carrier_hz)
    gain = propagation.db_to_linear(-loss_db) * channel.pattern_gain(
        radio.element_pattern, radio.element_exponent, cosine
    )
    return gain[..., -1], gain[..., :-1]


@compiled
def _directions(
    ends: FloatArray, places: FloatArray, height_m: float, headings: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances [E, P, L] [m] from panels at `places` [E, P, 2] to `ends` [E, L, 3], and the cosines off boresight."""
    shape = (*places.shape[:2], ends.shape[1])
    distance, cosine = np.empty(shape), np.empty(shape)
    for e in range(shape[0]):
        for p in range(shape[1]):
            forward_x, forward_y = math.cos(headings[e, p]), math.sin(headings[e, p])
            for end in range(shape[2]):
                x, y = ends[e, end, 0] - places[e, p, 0], ends[e, end, 1] - places[e, p, 1]
                distance[e, p, end] = math.sqrt(x * x + y * y + (ends[e, end, 2] - height_m) ** 2)
                cosine[e, p, end] = (forward_x * x + forward_y * y) / max(distance[e, p, end], 1e-12)
    return distance, cosine


def place_values(simulator: Simulator, places: FloatArray) -> FloatArray:
    """Predicted sum rate with the QoS penalty, [E, P] [bit/s], with the RIS at `places` [E, P, 2] [m]."""
    return _values(simulator, *link_gains(simulator, places))


def bare_values(simulator: Simulator) -> FloatArray:
    """The same prediction without RIS, [E] [bit/s]."""
    nothing = np.zeros((simulator.num_cells, 1, simulator.config.world.num_users))
    return _values(simulator, nothing[..., 0], nothing)[:, 0]


def _values(simulator: Simulator, incident: FloatArray, reflected: FloatArray) -> FloatArray:
    config = simulator.config
    direct = propagation.db_to_linear(-simulator.scene.path_loss_db[:, None, : config.world.num_users])
    direct = np.broadcast_to(direct, reflected.shape)
    rates = prediction.predicted_rates(
        direct, incident, reflected, simulator.clusters, config.radio, config.task.qos_bps
    )
    return penalised(rates, config.task.qos_bps, config.task.qos_penalty)


def node_values(simulator: Simulator) -> FloatArray:
    """`place_values` [E, n] [bit/s] at the nodes of `World.paths`, -inf where unreachable."""
    paths = simulator.world.paths
    places = np.broadcast_to(paths.nodes, (simulator.num_cells, *paths.nodes.shape))
    return np.where(paths.reachable, _in_chunks(simulator, places), -np.inf)


def best_goals(simulator: Simulator, horizon_slots: int = 12) -> tuple[FloatArray, FloatArray]:
    """Where to drive [E, 2] [m] for the largest predicted sum over the next slots, and the mean of that [E] [bit/s].

    Of the nodes of `World.paths` and the present place, the way there included. Users are taken to stay where they
    are; the horizon is short because they do not.
    """
    world, paths = simulator.world, simulator.world.paths
    here = world.fleet.xy
    horizon_m = horizon_slots * world.config.max_speed_mps * world.config.slot_s
    way_m = paths.distance_to_nodes(here)
    within = way_m < horizon_m
    # Only what can be reached by then is valued: as many nodes in every cell as in the one that has most.
    near = np.argsort(~within, axis=1, kind="stable")[:, : within.sum(1).max()]
    predicted = _in_chunks(simulator, np.concatenate([here[:, None], paths.nodes[near]], 1))
    present, values = predicted[:, 0], np.zeros(way_m.shape)
    np.put_along_axis(values, near, predicted[:, 1:], 1)
    staying = np.maximum(horizon_m - way_m, 0) * values
    total = np.where(within, paths.along(way_m, present, values, horizon_m) + staying, -np.inf)
    stay = horizon_m * present >= total.max(1)
    goal = np.where(stay[:, None], here, paths.nodes[total.argmax(1)])
    return goal, np.maximum(horizon_m * present, total.max(1)) / horizon_m


def _in_chunks(simulator: Simulator, places: FloatArray) -> FloatArray:
    """`place_values`, of some of the places at a time."""
    parts = np.array_split(places, max(1, places.shape[0] * places.shape[1] // _CHUNK), axis=1)
    return np.concatenate([place_values(simulator, part) for part in parts], 1)


def penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> FloatArray:
    """Sum rate [...] of rates [..., K] [bit/s], divided by λ where any user misses QoS, eq. (R)."""
    total = rates_bps.sum(-1)
    return np.where((rates_bps >= qos_bps).all(-1), total, total / penalty)
