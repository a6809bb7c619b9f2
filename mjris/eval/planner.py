"""The rival that a practitioner would try first: a receding horizon over the radio map, driven on shortest ways."""

import numpy as np
from numpy.typing import NDArray

from mjris.radiomap import place_values
from mjris.simulator import Simulator
from mjris.world.office import PERSON_RADIUS_M

FloatArray = NDArray[np.floating]

_CHUNK = 4096
"""Places of all cells that are predicted together, which bounds the memory."""


def node_values(simulator: Simulator) -> FloatArray:
    """Predicted sum rates with the QoS penalty [E, n] [bit/s] at the nodes of `World.paths`, -inf where unreachable."""
    paths, cells = simulator.world.paths, simulator.num_cells
    parts = np.array_split(paths.nodes, max(1, len(paths.nodes) * cells // _CHUNK))
    values = [place_values(simulator, np.broadcast_to(part, (cells, *part.shape))) for part in parts]
    return np.where(paths.reachable, np.concatenate(values, 1), -np.inf)


def best_places(simulator: Simulator) -> tuple[FloatArray, FloatArray]:
    """Best-known places over the floor that the rovers can reach [E, 2] [m], and their values [E] [bit/s]."""
    values = node_values(simulator)
    best = values.argmax(1)
    return simulator.world.paths.nodes[best], values.max(1)


class Planner:
    """Drives every rover to where the predicted sum over the next slots is largest, the way there included."""

    def __init__(self, replan_slots: int = 5, horizon_slots: int = 30):
        self._replan_slots = replan_slots
        self._horizon_slots = horizon_slots
        self._slot = 0
        self._goal: FloatArray

    def displacement(self, simulator: Simulator) -> FloatArray:
        """What to command in the next slot [E, 2] [m]."""
        if self._slot % self._replan_slots == 0:
            self._goal = self._best_goal(simulator)
        self._slot += 1
        world = simulator.world
        here = world.fleet.xy
        target = world.paths.toward(here, self._goal)
        gap = world.paths.keep_m + PERSON_RADIUS_M
        move = world.paths.around(here, target, world.crowd.xy, gap) - here
        reach = world.config.max_speed_mps * world.config.slot_s
        return move * np.minimum(1, reach / np.maximum(np.linalg.norm(move, axis=-1, keepdims=True), 1e-12))

    def _best_goal(self, simulator: Simulator) -> FloatArray:
        world, paths = simulator.world, simulator.world.paths
        here = world.fleet.xy
        reach = world.config.max_speed_mps * world.config.slot_s
        values = node_values(simulator)
        present = place_values(simulator, here[:, None])
        slots = np.minimum(paths.distance_to_nodes(here) / reach, self._horizon_slots)
        # On the way the value is taken to change evenly.
        total = slots * (present + values) / 2 + (self._horizon_slots - slots) * values
        best = total.argmax(1)
        stay = self._horizon_slots * present[:, 0] >= total.max(1)
        return np.where(stay[:, None], here, paths.nodes[best])
