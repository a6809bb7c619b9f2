"""The best-known places for the RIS over the floor that rovers can reach, of the radio map."""

import numpy as np
from numpy.typing import NDArray

from mjris.simulation.outlook import node_values, place_values
from mjris.simulation.simulator import Simulator

FloatArray = NDArray[np.floating]

_REFINING_STEPS_M = (0.25, 0.125)
_AROUND = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)])


def best_places(simulator: Simulator) -> tuple[FloatArray, FloatArray]:
    """Best-known places [E, 2] [m] over the floor that the rovers can reach, and their predicted values [E] [bit/s].

    The best node of `Terrain.paths`, then the best of finer and finer steps around it.
    """
    world, paths = simulator.world, simulator.terrain.paths
    cells = np.arange(simulator.num_cells)
    values = node_values(simulator)
    best, value = paths.nodes[values.argmax(1)], values.max(1)
    for step_m in _REFINING_STEPS_M:
        places = best[:, None] + step_m * _AROUND
        free = world.free_share(best[:, None], places, paths.keep_m) == np.inf
        # The place itself stays a candidate, even where rounding would put it a hair too close to something.
        values = np.where(free | ~_AROUND.any(-1), place_values(simulator, places), -np.inf)
        best, value = places[cells, values.argmax(1)], values.max(1)
    return best, value
