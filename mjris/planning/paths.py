"""Shortest ways over the free floor: distances between the nodes of a grid, and where to drive next."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.config import ConfigError
from mjris.jit.compiled import compiled
from mjris.planning import wayfinding
from mjris.world.footprints import Footprints

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SPACING_M = 0.5
_MOST_NODES = 1300
"""Larger rooms get a wider grid: memory grows with the square of the nodes, time with the cube."""
_STEPS = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (2, 1), (1, 2), (-1, 2), (-2, 1)])
"""Half of a node's sixteen neighbours, in grid steps; the others are opposite. Ways are at most 2.8 % too long."""
_SLACK_M = 0.01
"""Edges keep this much more, so that they are in free sight for a rover that is not quite on a node."""
_NEAR_NODES = 16
"""Nodes around a place that are tried as the first one of its way."""


class Paths:
    """Ways that keep `keep_m` [m] from everything in `solid`, for one office or one a cell, as in `Footprints`.

    Footprints grow with square corners, so that a way may keep more distance from a corner than it must. Memory for
    large batches with furniture of their own: 4 n² bytes a cell.
    """

    def __init__(self, solid: Footprints, room_m: tuple[float, float], start: FloatArray, keep_m: float):
        """The grid goes through `start` [m]. Raises `ConfigError` if no place is `keep_m` [m] from everything."""
        self.keep_m = keep_m
        places, neighbours = _grid(np.array(room_m), start)
        length = _edge_lengths(solid, places, neighbours, keep_m + _SLACK_M)
        reached = _connected(length, neighbours, np.linalg.norm(places - start, axis=-1))
        if not reached.any(-1).all():
            raise ConfigError(f"keep_m: {keep_m} is not allowed: there is no way that far from everything")
        kept = reached.any(0)
        self.nodes: FloatArray = places[kept]
        """Places of the grid that can be reached from the start, in one office at least, [n, 2] [m]."""
        self.reachable: BoolArray = reached[:, kept]
        """Which of them can be, [E or 1, n]."""
        # Neighbours that are dropped have no edges, so that it does not matter what stands for them.
        neighbours = np.maximum(np.cumsum(kept) - 1, 0)[neighbours[kept]]
        edge_m = np.where(self.reachable[..., None], length[:, kept], np.inf).astype(np.float32)
        self.distances = np.stack([_all_pairs(neighbours, edge) for edge in edge_m])
        """Lengths of the shortest ways between nodes [E or 1, n, n] [m], inf where there is none."""
        tried = min(_NEAR_NODES, int(self.reachable.sum(-1).min()))
        self.graph = wayfinding.Graph(
            self.nodes, self.reachable, neighbours, edge_m, self.distances, solid.arrays, keep_m, tried
        )
        """What compiled loops work on."""

    def toward(self, start: FloatArray, goal: FloatArray) -> FloatArray:
        """The next places [E, 2] [m] to drive straight at on the way from `start` to `goal`, both [E, 2] [m].

        That is the goal if the straight way there is free, or else the furthest place of the way that is in free
        sight. A goal that cannot be reached is moved to the node nearest to it.
        """
        return wayfinding.next_places(self.graph, start, goal)

    def distance(self, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Lengths [E] [m] of the shortest ways from `start` to `goal`, both [E, 2] [m], as `toward` would drive."""
        return wayfinding.lengths(self.graph, start, goal)

    def distance_to_nodes(self, start: FloatArray) -> FloatArray:
        """Lengths [E, n] [m] of the shortest ways from `start` [E, 2] [m] to all nodes, inf where there is none."""
        return wayfinding.lengths_to_nodes(self.graph, start)

    def along(self, length: FloatArray, present: FloatArray, values: FloatArray, most_m: float) -> FloatArray:
        """Integrals of a value along the shortest ways to all nodes [E, n], for their lengths [E, n] [m].

        The lengths are those of `distance_to_nodes`. The value is `present` [E] at the start and `values` [E, n] at
        the nodes, and changes evenly between them. Zero for nodes that are not within `most_m` [m].
        """
        return wayfinding.integrals_along(self.graph, length, present, values, most_m)

    def around(self, start: FloatArray, target: FloatArray, people: FloatArray, gap_m: float) -> FloatArray:
        """Places [E, 2] [m] to drive straight at from `start` to `target` [E, 2] [m], around `people` [E, K, 2] [m].

        That is `target` unless somebody stands within `gap_m` [m] of the next metre of the way, or where nobody can
        be driven around.
        """
        return wayfinding.around_people(self.graph, start, target, people, gap_m)


def _edge_lengths(solid: Footprints, places: FloatArray, neighbours: IntArray, keep_m: float) -> FloatArray:
    """Lengths [E or 1, N, 16] [m] of the ways to the neighbours [N, 16] of `places` [N, 2] [m], inf if not free."""
    half = len(_STEPS)
    ends = np.broadcast_to(places[neighbours], (solid.centre.shape[1], *neighbours.shape, 2))
    start = np.broadcast_to(places, ends[:, :, 0].shape)
    ahead = np.stack([solid.free_run(start, ends[:, :, step], keep_m) for step in range(half)], -1)
    # The way back is the neighbour's way ahead.
    free = np.concatenate([ahead, ahead[:, neighbours[:, half:], np.arange(half)]], -1)
    length = np.linalg.norm(places[neighbours] - places[:, None], axis=-1)
    return np.where(free & (length > 0), length, np.inf)


def _grid(room_m: FloatArray, start: FloatArray) -> tuple[FloatArray, IntArray]:
    """Places [N, 2] [m] of a grid through `start` over the room, and the neighbours of each [N, 16].

    Where the room ends, a place is its own neighbour.
    """
    spacing = max(_SPACING_M, math.sqrt(room_m.prod() / _MOST_NODES))
    before, after = (start // spacing).astype(int), ((room_m - start) // spacing).astype(int)
    columns, rows = before + after + 1
    index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1).reshape(-1, 2)
    other = index[:, None] + np.concatenate([_STEPS, -_STEPS])
    inside = ((other >= 0) & (other < (columns, rows))).all(-1)
    neighbours = np.where(inside, other[..., 0] * rows + other[..., 1], np.arange(len(index))[:, None])
    return start + spacing * (index - before), neighbours


def _connected(length: FloatArray, neighbours: IntArray, from_start: FloatArray) -> BoolArray:
    """Which nodes are connected by edges [G, N, 16] to the one with any that is nearest to the start [N], [G, N]."""
    usable = np.isfinite(length)
    nearest = np.where(usable.any(-1), from_start, np.inf)
    reached = (np.arange(usable.shape[1]) == nearest.argmin(1)[:, None]) & usable.any(-1)
    while True:
        grown = reached | (reached[:, neighbours] & usable).any(-1)
        if (grown == reached).all():
            return reached
        reached = grown


@compiled
def _all_pairs(neighbours: IntArray, edge_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Shortest distances [n, n] over edges [n, 16] (R. Floyd, Algorithm 97, 1962)."""
    count = len(edge_m)
    distance = np.full((count, count), np.inf, np.float32)
    for a in range(count):
        for way in range(neighbours.shape[1]):
            b = neighbours[a, way]
            distance[a, b] = min(distance[a, b], edge_m[a, way])
        distance[a, a] = 0
    for via in range(count):
        for a in range(count):
            there = distance[a, via]
            if there < np.inf:
                for b in range(count):
                    distance[a, b] = min(distance[a, b], there + distance[via, b])
    return distance
