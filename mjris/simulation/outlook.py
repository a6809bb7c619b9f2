"""What places are worth to the RIS in the present scene of a simulator: the radio map around the rovers."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.planning import prediction, radio_map
from mjris.planning.radio_map import Ground, penalised
from mjris.simulation.simulator import Simulator

FloatArray = NDArray[np.floating]


def place_values(simulator: Simulator, places: FloatArray) -> FloatArray:
    """Predicted sum rate with the QoS penalty, [E, P] [bit/s], with the rover's panel at `places` [E, P, 2] [m].

    Obstacles are those of the `sight_map`, distances exact. The panel faces the bisector of AP and users, as the pan
    motor would turn it. Fixed panels count as they do in the present slot.
    """
    everywhere = np.ones(places.shape[:2], np.bool_)
    return radio_map.values_at(_ground(simulator), np.ascontiguousarray(places), everywhere)


def bare_values(simulator: Simulator) -> FloatArray:
    """The same prediction without RIS, [E] [bit/s]."""
    config, direct = simulator.config, simulator.scene.mean_gain[:, simulator.links.direct]
    nothing, qos_bps = np.zeros_like(direct), config.task.qos_bps
    rates = prediction.predicted_rates(direct, nothing[:, 0], nothing, simulator.clusters, config.radio, qos_bps)
    return penalised(rates, qos_bps, config.task.qos_penalty)


def node_values(simulator: Simulator, heading_rad: float = math.nan) -> FloatArray:
    """`place_values` [E, n] [bit/s] at the nodes of `Terrain.paths`, -inf where unreachable.

    With a heading all panels face there, counter-clockwise from +x [rad].
    """
    paths = simulator.terrain.paths
    reachable = np.resize(paths.reachable, (simulator.num_cells, len(paths.nodes)))
    return radio_map.values_at(_ground(simulator, heading_rad), paths.nodes[None], reachable)


def best_goals(simulator: Simulator, *, walls: bool = True) -> tuple[FloatArray, FloatArray]:
    """Where to drive [E, 2] [m] for the largest predicted sum over the next slots, and the mean of that [E] [bit/s].

    Of the nodes of `Terrain.paths` and the present place, the way there included. Users are taken to stay where they
    are; the horizon is short because they do not. Without `walls` everything is taken to be in line of sight.
    """
    world, paths = simulator.config.world, simulator.terrain.paths
    here = simulator.scene.rover_xy
    horizon_m = simulator.config.task.horizon_slots * world.max_speed_mps * world.slot_s
    way_m = paths.distance_to_nodes(here, horizon_m)
    # Only what can be reached by then is valued.
    within, ground = way_m < horizon_m, _ground(simulator)
    if not walls:
        ground = ground._replace(seen=ground.seen.through_everything)
    present = radio_map.values_at(ground, here[:, None], np.ones((len(here), 1), np.bool_))[:, 0]
    values = radio_map.values_at(ground, paths.nodes[None], within)
    along = paths.along(way_m, present, values, horizon_m)
    return radio_map.best(here, paths.nodes, way_m, along, present, values, horizon_m)


def _ground(simulator: Simulator, heading_rad: float = math.nan) -> Ground:
    """What predictions for the present scene follow from."""
    config, users_xy = simulator.config, simulator.scene.known_users_xy
    receivers, arrays = np.insert(users_xy, 2, config.world.user_height_m, -1), prediction.Arrays.of(config.radio)
    return Ground(
        simulator.link_table,
        simulator.system,
        arrays,
        np.concatenate([receivers, simulator.ap_position[:, None]], 1),
        simulator.aims(users_xy),
        heading_rad,
        simulator.terrain.sight_map.seen(users_xy),
        _beside(simulator, arrays),
        config.task.qos_penalty,
    )


def _beside(simulator: Simulator, arrays: prediction.Arrays) -> prediction.Beside:
    """What reaches users without the rover's panel, which is the first."""
    links, gain = simulator.links, simulator.scene.mean_gain
    reflected = gain[:, links.reflected].reshape(len(gain), len(links.elements), -1)
    fixed = gain[:, links.incident][:, 1:], reflected[:, 1:], links.elements[1:]
    return prediction.beside_rover(simulator.system, arrays, gain[:, links.direct], *fixed)
