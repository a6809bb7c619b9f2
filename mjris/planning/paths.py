"""Shortest ways over the free floor: distances between the nodes of a grid, and where to drive next."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.config import ConfigError
from mjris.jit.compiled import compiled
from mjris.planning import wayfinding
from mjris.planning.fields import integrals_along
from mjris.world.footprints import Footprints, Rectangles, is_free, near

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SPACING_M = 0.5
_MOST_NODES = 1300
"""More of them have no table of all pairs: its memory grows with their square, its time with the cube."""
_STEPS = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (2, 1), (1, 2), (-1, 2), (-2, 1)])
"""Half of a node's sixteen neighbours, in grid steps; the others are opposite. Ways are at most 2.8 % too long."""
_LONGEST_STEP_M = _SPACING_M * math.sqrt(5)
_SLACK_M = 0.01
"""Edges keep this much more, so that they are in free sight for a rover that is not quite on a node."""
_NEAR_NODES = 16
"""Nodes around a place that are tried as the first one of its way."""


class Paths:
    """Ways that keep `keep_m` [m] from everything in `solid`, for one office or one a cell, as in `Footprints`.

    Footprints grow with square corners, so that a way may keep more distance from a corner than it must. Up to 1300
    nodes all distances are worked out beforehand, 4 n² bytes for each office; in larger rooms as far as they are
    needed, every time.
    """

    def __init__(self, solid: Footprints, room_m: tuple[float, float], start: FloatArray, keep_m: float):
        """The grid goes through `start` [m]. Raises `ConfigError` if no place is `keep_m` [m] from everything."""
        self.keep_m = keep_m
        places, neighbours = _grid(np.array(room_m), start)
        length = _edge_lengths(solid.arrays, places, neighbours, keep_m + _SLACK_M)
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
        tabled = len(self.nodes) <= _MOST_NODES
        self.distances = np.stack([_all_pairs(neighbours, edge if tabled else edge[:0]) for edge in edge_m])
        """Lengths of the shortest ways between nodes [E or 1, n, n] [m], inf where there is none.

        In large rooms there are none of them [E or 1, 0, 0]."""
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

    def distance_to_nodes(self, start: FloatArray, most_m: float = math.inf) -> FloatArray:
        """Lengths [E, n] [m] of the shortest ways from `start` [E, 2] [m] to all nodes, inf where there is none.

        Those that are longer than `most_m` [m] may be too long.
        """
        return wayfinding.lengths_to_nodes(self.graph, start, most_m)

    def along(self, length: FloatArray, present: FloatArray, values: FloatArray, most_m: float) -> FloatArray:
        """Integrals of a value along the shortest ways to all nodes [E, n], for their lengths [E, n] [m].

        The lengths are those of `distance_to_nodes`. The value is `present` [E] at the start and `values` [E, n] at
        the nodes, and changes evenly between them. Zero for nodes that are not within `most_m` [m].
        """
        return integrals_along(self.graph.neighbours, self.graph.edge_m, length, present, values, most_m)

    def around(self, start: FloatArray, target: FloatArray, people: FloatArray, gap_m: float) -> FloatArray:
        """Places [E, 2] [m] to drive straight at from `start` to `target` [E, 2] [m], around `people` [E, K, 2] [m].

        That is `target` unless somebody stands within `gap_m` [m] of the next metre of the way, or where nobody can
        be driven around.
        """
        return wayfinding.around_people(self.graph, start, target, people, gap_m)


@compiled
def _edge_lengths(solid: Rectangles, places: FloatArray, neighbours: IntArray, keep_m: float) -> FloatArray:
    """Lengths [E or 1, N, 16] [m] of the ways to the neighbours [N, 16] of `places` [N, 2] [m], inf if not free."""
    length = np.full((solid[0].shape[1], *neighbours.shape), np.inf)
    half = neighbours.shape[1] // 2
    for office in range(len(length)):
        for a in range(len(places)):
            x, y = places[a]
            # No way leads past what is further away than its end.
            close = near(solid, office, x, y, _LONGEST_STEP_M + 2 * keep_m)
            for way in range(half):
                b = neighbours[a, way]
                u, v = places[b, 0] - x, places[b, 1] - y
                if b != a and is_free(close, 0, x, y, u, v, keep_m):
                    # The way back is the neighbour's way ahead.
                    length[office, a, way] = length[office, b, half + way] = math.sqrt(u * u + v * v)
    return length


def _grid(room_m: FloatArray, start: FloatArray) -> tuple[FloatArray, IntArray]:
    """Places [N, 2] [m] of a grid through `start` over the room, and the neighbours of each [N, 16].

    Where the room ends, a place is its own neighbour.
    """
    before, after = (start // _SPACING_M).astype(int), ((room_m - start) // _SPACING_M).astype(int)
    columns, rows = before + after + 1
    index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1).reshape(-1, 2)
    other = index[:, None] + np.concatenate([_STEPS, -_STEPS])
    inside = ((other >= 0) & (other < (columns, rows))).all(-1)
    neighbours = np.where(inside, other[..., 0] * rows + other[..., 1], np.arange(len(index))[:, None])
    return start + _SPACING_M * (index - before), neighbours


@compiled
def _connected(length: FloatArray, neighbours: IntArray, from_start: FloatArray) -> BoolArray:
    """Which nodes are connected by edges [G, N, 16] to the one with any that is nearest to the start [N], [G, N]."""
    reached = np.zeros(length.shape[:2], np.bool_)
    for office in range(len(length)):
        nearest, found = np.inf, -1
        for node in range(len(from_start)):
            if from_start[node] < nearest and length[office, node].min() < np.inf:
                nearest, found = from_start[node], node
        if found < 0:
            continue
        reached[office, found], todo = True, [found]
        while todo:
            node = todo.pop()
            for way in range(neighbours.shape[1]):
                other = neighbours[node, way]
                if length[office, node, way] < np.inf and not reached[office, other]:
                    reached[office, other] = True
                    todo.append(other)
    return reached


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
