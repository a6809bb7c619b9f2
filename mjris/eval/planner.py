"""The rival that a practitioner would try first: a receding horizon over the radio map, driven on shortest ways."""

import numpy as np
from numpy.typing import NDArray

from mjris.radiomap import place_values
from mjris.simulator import Simulator

FloatArray = NDArray[np.floating]

_CHUNK = 4096
"""Places of all cells that are predicted together, which bounds the memory."""
_REFINING_STEPS_M = (0.25, 0.125)
_AROUND = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)])


def node_values(simulator: Simulator) -> FloatArray:
    """Predicted sum rates with the QoS penalty [E, n] [bit/s] at the nodes of `World.paths`, -inf where unreachable."""
    paths, cells = simulator.world.paths, simulator.num_cells
    parts = np.array_split(paths.nodes, max(1, len(paths.nodes) * cells // _CHUNK))
    values = [place_values(simulator, np.broadcast_to(part, (cells, *part.shape))) for part in parts]
    return np.where(paths.reachable, np.concatenate(values, 1), -np.inf)


def best_places(simulator: Simulator) -> tuple[FloatArray, FloatArray]:
    """Best-known places [E, 2] [m] over the floor that the rovers can reach, and their predicted values [E] [bit/s].

    The best node of `World.paths`, then the best of finer and finer steps around it.
    """
    world = simulator.world
    cells = np.arange(simulator.num_cells)
    values = node_values(simulator)
    best, value = world.paths.nodes[values.argmax(1)], values.max(1)
    for step_m in _REFINING_STEPS_M:
        places = best[:, None] + step_m * _AROUND
        free = world.free_share(np.broadcast_to(best[:, None], places.shape), places, world.paths.keep_m) == np.inf
        # The place itself stays a candidate, even where rounding would put it a hair too close to something.
        values = np.where(free | ~_AROUND.any(-1), place_values(simulator, places), -np.inf)
        best, value = places[cells, values.argmax(1)], values.max(1)
    return best, value


class Planner:
    """Drives every rover to where the predicted sum over the next slots is largest, the way there included.

    Users are taken to stay where they are: the horizon is short because they do not.
    """

    def __init__(self, replan_slots: int = 1, horizon_slots: int = 12):
        self._replan_slots = replan_slots
        self._horizon_slots = horizon_slots
        self._slot = 0
        self._goal: FloatArray

    def displacement(self, simulator: Simulator) -> FloatArray:
        """What to command in the next slot of an episode [E, 2] [m]."""
        if self._slot % self._replan_slots == 0:
            self._goal = self._best_goal(simulator)
        self._slot += 1
        return simulator.world.way_toward(self._goal)

    def _best_goal(self, simulator: Simulator) -> FloatArray:
        """The node, or the present place, with the largest predicted sum over the horizon, [E, 2] [m]."""
        world, paths = simulator.world, simulator.world.paths
        here = world.fleet.xy
        horizon_m = self._horizon_slots * world.config.max_speed_mps * world.config.slot_s
        present, values = place_values(simulator, here[:, None])[:, 0], node_values(simulator)
        way_m, on_the_way = paths.along(here, present, values)
        within = way_m < horizon_m
        staying = np.where(within, (horizon_m - way_m) * np.where(within, values, 0), -np.inf)
        total = on_the_way + staying
        stay = horizon_m * present >= total.max(1)
        return np.where(stay[:, None], here, paths.nodes[total.argmax(1)])
