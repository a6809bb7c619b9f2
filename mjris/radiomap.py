"""The radio map: what a place is worth to the RIS, predicted from the layout and where the users stand."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.radio import links, prediction, propagation
from mjris.radio.serving import System
from mjris.simulator import Simulator
from mjris.world.sightmap import Grid, square

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
SmallArray = NDArray[np.int8]


class _Floor(NamedTuple):
    """What predictions for places of E cells follow from."""

    medium: links.Medium
    system: System
    arrays: prediction.Arrays
    grid: Grid
    ends: FloatArray
    """Users and, last, AP [E, K + 1, 3] [m]."""
    blockers: SmallArray
    """Obstacles from there to the squares of the grid [E, K + 1, s]."""
    direct: FloatArray
    """Power gains of the links AP–users [E, K]."""
    panel_height_m: float
    qos_penalty: float
    """λ of eq. (R)."""


def _floor(simulator: Simulator) -> _Floor:
    """What predictions for the present scene follow from."""
    config, world = simulator.config, simulator.world
    receivers = world.receivers()
    return _Floor(
        simulator.medium,
        simulator.system,
        prediction.Arrays.of(config.radio),
        world.sight_map.grid,
        np.concatenate([receivers, simulator.ap_position[:, None]], 1),
        world.sight_map.blockers(world.crowd.xy),
        _direct_gains(simulator),
        world.config.panel_height_m,
        config.task.qos_penalty,
    )


def place_values(simulator: Simulator, places: FloatArray) -> FloatArray:
    """Predicted sum rate with the QoS penalty, [E, P] [bit/s], with the RIS at `places` [E, P, 2] [m].

    Obstacles are those of the `sight_map`, distances exact. The panel faces the bisector of AP and users, as the pan
    motor would turn it.
    """
    return _values(_floor(simulator), np.ascontiguousarray(places), np.ones(places.shape[:2], np.bool_))


def bare_values(simulator: Simulator) -> FloatArray:
    """The same prediction without RIS, [E] [bit/s]."""
    config, direct = simulator.config, _direct_gains(simulator)
    nothing, qos_bps = np.zeros_like(direct), config.task.qos_bps
    rates = prediction.predicted_rates(direct, nothing[:, 0], nothing, simulator.clusters, config.radio, qos_bps)
    return penalised(rates, qos_bps, config.task.qos_penalty)


def node_values(simulator: Simulator) -> FloatArray:
    """`place_values` [E, n] [bit/s] at the nodes of `World.paths`, -inf where unreachable."""
    paths = simulator.world.paths
    reachable = np.resize(paths.reachable, (simulator.num_cells, len(paths.nodes)))
    return _values(_floor(simulator), paths.nodes[None], reachable)


def best_goals(simulator: Simulator, horizon_slots: int = 12) -> tuple[FloatArray, FloatArray]:
    """Where to drive [E, 2] [m] for the largest predicted sum over the next slots, and the mean of that [E] [bit/s].

    Of the nodes of `World.paths` and the present place, the way there included. Users are taken to stay where they
    are; the horizon is short because they do not.
    """
    world, paths = simulator.world, simulator.world.paths
    here = world.fleet.xy
    horizon_m = horizon_slots * world.config.max_speed_mps * world.config.slot_s
    way_m = paths.distance_to_nodes(here)
    # Only what can be reached by then is valued.
    within, ground = way_m < horizon_m, _floor(simulator)
    present = _values(ground, here[:, None], np.ones((len(here), 1), np.bool_))[:, 0]
    values = _values(ground, paths.nodes[None], within)
    along = paths.along(way_m, present, values, horizon_m)
    return _best(here, paths.nodes, way_m, along, present, values, horizon_m)


def penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> FloatArray:
    """Sum rate [...] of rates [..., K] [bit/s], divided by λ where any user misses QoS, eq. (R)."""
    flat = np.ascontiguousarray(rates_bps).reshape(-1, rates_bps.shape[-1])
    return _all_penalised(flat, qos_bps, penalty).reshape(rates_bps.shape[:-1])


def _direct_gains(simulator: Simulator) -> FloatArray:
    return propagation.db_to_linear(-simulator.scene.path_loss_db[:, : simulator.config.world.num_users])


@compiled
def _best(
    here: FloatArray,
    nodes: FloatArray,
    way_m: FloatArray,
    along: FloatArray,
    present: FloatArray,
    values: FloatArray,
    horizon_m: float,
) -> tuple[FloatArray, FloatArray]:
    """`best_goals` for ways to nodes [E, n] [m], integrals of the value along them, and values here [E] and there."""
    goal, mean = here.copy(), present.copy()
    for e in range(len(here)):
        for node in range(len(nodes)):
            if way_m[e, node] < horizon_m:
                then = (along[e, node] + (horizon_m - way_m[e, node]) * values[e, node]) / horizon_m
                if then > mean[e]:
                    goal[e], mean[e] = nodes[node], then
    return goal, mean


@compiled
def _values(ground: _Floor, places: FloatArray, wanted: BoolArray) -> FloatArray:
    """Values [E, P] [bit/s] of those `places` [E or 1, P, 2] [m] that are wanted [E, P], -inf of the others."""
    values = np.full(wanted.shape, -np.inf)
    medium, grid = ground.medium, ground.grid
    work, reflected = prediction.workspace(ground.system), np.empty(ground.direct.shape[1])
    for e in range(wanted.shape[0]):
        here, ends, blockers, direct = places[e % len(places)], ground.ends[e], ground.blockers[e], ground.direct[e]
        for p in range(wanted.shape[1]):
            if wanted[e, p]:
                x, y = here[p, 0], here[p, 1]
                incident = _link_gains(medium, grid, ground.panel_height_m, ends, blockers, x, y, reflected)
                prediction.predict(ground.system, ground.arrays, direct, incident, reflected, work)
                values[e, p] = _penalised(work.rates, ground.system.qos_bps, ground.qos_penalty)
    return values


@compiled
def _link_gains(
    medium: links.Medium,
    grid: Grid,
    height_m: float,
    ends: FloatArray,
    blockers: SmallArray,
    x: float,
    y: float,
    reflected: FloatArray,
) -> float:
    """The power gain AP–RIS of a panel at a place, patterns included; writes those of RIS–users to `reflected` [K].

    Its centre is `height_m` above the floor; `ends` [K + 1, 3] and `blockers` [K + 1, s] are a cell's part of those in
    `_Floor`.
    """
    here, incident = square(grid, x, y), 0.0
    forward_x, forward_y = links.bisector(ends, x, y)
    facing = forward_x * forward_x + forward_y * forward_y
    for end in range(len(ends)):
        to_x, to_y, to_z = ends[end, 0] - x, ends[end, 1] - y, ends[end, 2] - height_m
        squared = to_x * to_x + to_y * to_y + to_z * to_z
        cosine = (forward_x * to_x + forward_y * to_y) / math.sqrt(max(squared * facing, 1e-24))
        gain = links.panel_gain(medium, squared, blockers[end, here], cosine)
        if end < len(reflected):
            reflected[end] = gain
        else:
            incident = gain
    return incident


@compiled
def _all_penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> FloatArray:
    values = np.empty(len(rates_bps))
    for row in range(len(values)):
        values[row] = _penalised(rates_bps[row], qos_bps, penalty)
    return values


@compiled
def _penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> float:
    """`penalised` for one slot's rates [K]."""
    total, least = 0.0, np.inf
    for rate in rates_bps:
        total, least = total + rate, min(least, rate)
    return total / (penalty if least < qos_bps else 1.0)
