"""The radio map: what a place is worth to the RIS, predicted from the layout and where the users stand."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.radio import links, prediction, propagation
from mjris.simulator import Simulator

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

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
    places = np.ascontiguousarray(places)
    return _gains(
        links.Medium.of(radio),
        ends,
        places,
        world.config.panel_height_m,
        simulator.bisector(places),
        world.sight_map.between(receivers[..., :2], places),
        world.sight_map.from_ap(places),
    )


@compiled
def _gains(
    medium: links.Medium,
    ends: FloatArray,
    places: FloatArray,
    height_m: float,
    headings: FloatArray,
    users_blockers: IntArray,
    ap_blockers: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """`link_gains` for users and AP at `ends` [E, K + 1, 3] [m], panels that face `headings` [E, P] and blockers."""
    users = ends.shape[1] - 1
    incident, reflected = np.empty(headings.shape), np.empty((*headings.shape, users))
    for e in range(headings.shape[0]):
        for p in range(headings.shape[1]):
            forward_x, forward_y = math.cos(headings[e, p]), math.sin(headings[e, p])
            for end in range(users + 1):
                x, y = ends[e, end, 0] - places[e, p, 0], ends[e, end, 1] - places[e, p, 1]
                distance = math.sqrt(x * x + y * y + (ends[e, end, 2] - height_m) ** 2)
                cosine = (forward_x * x + forward_y * y) / max(distance, 1e-12)
                blockers = users_blockers[e, p, end] if end < users else ap_blockers[e, p]
                loss_db = links.path_loss_db(medium, distance, blockers)
                gain = 10.0 ** (-loss_db / 10) * links.pattern_gain(medium, cosine)
                if end < users:
                    reflected[e, p, end] = gain
                else:
                    incident[e, p] = gain
    return incident, reflected


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
