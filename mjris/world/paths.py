"""Shortest ways over the free floor: distances between the nodes of a grid, and where to drive next."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.config import ConfigError
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
_SAMPLES = 12
"""Points of the way to such a node at which a rover that stands too close to something looks."""
_RISE = 0.2
"""Such a rover is to gain this much distance per distance driven."""

_LOOK_M = 1.0
"""How far ahead a rover looks for people who stand in its way."""
_TURNS = np.radians([0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90, -90])
"""Turns with which it tries to drive around them."""


class Paths:
    """Ways that keep `keep_m` [m] from everything in `solid`, for one office or one a cell, as in `Footprints`.

    Footprints grow with square corners, so that a way may keep more distance from a corner than it must. Memory for
    large batches with furniture of their own: 4 n² bytes a cell.
    """

    def __init__(self, solid: Footprints, room_m: tuple[float, float], start: tuple[float, float], keep_m: float):
        """The grid goes through `start` [m]. Raises `ConfigError` if no place is `keep_m` [m] from everything."""
        self.keep_m = keep_m
        self._solid = solid
        self._offices = solid.centre.shape[1]
        places, neighbours = _grid(np.array(room_m), np.array(start))
        length = self._edge_lengths(places, neighbours)
        reached = _connected(length, neighbours, np.linalg.norm(places - start, axis=-1))
        if not reached.any(-1).all():
            raise ConfigError(f"keep_m: {keep_m} is not allowed: there is no way that far from everything")
        kept = reached.any(0)
        self.nodes: FloatArray = places[kept]
        """Places of the grid that can be reached from the start, in one office at least, [n, 2] [m]."""
        self.reachable: BoolArray = reached[:, kept]
        """Which of them can be, [E or 1, n]."""
        # Neighbours that are dropped have no edges, so that it does not matter what stands for them.
        self._neighbours = np.maximum(np.cumsum(kept) - 1, 0)[neighbours[kept]]
        self._edge_m = np.where(self.reachable[..., None], length[:, kept], np.inf).astype(np.float32)
        self.distances = np.stack([_all_pairs(self._neighbours, edge) for edge in self._edge_m])
        """Lengths of the shortest ways between nodes [E or 1, n, n] [m], inf where there is none."""

    def toward(self, start: FloatArray, goal: FloatArray) -> FloatArray:
        """The next places [E, 2] [m] to drive straight at on the way from `start` to `goal`, both [E, 2] [m].

        That is the goal if the straight way there is free, or else the furthest place of the way that is in free
        sight. A goal that cannot be reached is moved to the node nearest to it.
        """
        goal, last, last_m = self._last_nodes(goal)
        first, first_m = self._first_nodes(start)
        _, a, b = self._shortest(first, first_m, last, last_m)
        way = np.concatenate([self.nodes[self._walk(a, b)], goal[:, None]], 1)
        seen = self._sees(start, way)
        # The first node is where to go when nothing is in free sight, as it is for a rover too close to something.
        furthest = np.where(seen.any(1), seen.shape[1] - 1 - seen[:, ::-1].argmax(1), 0)
        return way[np.arange(len(way)), furthest]

    def distance(self, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Lengths [E] [m] of the shortest ways from `start` to `goal`, both [E, 2] [m], as `toward` would drive."""
        goal, last, last_m = self._last_nodes(goal)
        first, first_m = self._first_nodes(start)
        along, _, _ = self._shortest(first, first_m, last, last_m)
        straight = np.linalg.norm(goal - start, axis=-1)
        return np.where(self._sees(start, goal[:, None])[:, 0], straight, along)

    def distance_to_nodes(self, start: FloatArray) -> FloatArray:
        """Lengths [E, n] [m] of the shortest ways from `start` [E, 2] [m] to all nodes, inf where there is none."""
        return _to_nodes(*self._first_nodes(start), self.distances)

    def along(self, length: FloatArray, present: FloatArray, values: FloatArray, most_m: float) -> FloatArray:
        """Integrals of a value along the shortest ways to all nodes [E, n], for their lengths [E, n] [m].

        The lengths are those of `distance_to_nodes`. The value is `present` [E] at the start and `values` [E, n] at
        the nodes, and changes evenly between them. Zero for nodes that are not
        within `most_m` [m].
        """
        return _along(length, present, values, most_m, self._neighbours, self._edge_m)

    def around(self, start: FloatArray, target: FloatArray, people: FloatArray, gap_m: float) -> FloatArray:
        """Places [E, 2] [m] to drive straight at from `start` to `target` [E, 2] [m], around `people` [E, K, 2] [m].

        That is `target` unless somebody stands within `gap_m` [m] of the next metre of the way, or where nobody can
        be driven around.
        """
        way = target - start
        reach = np.minimum(np.linalg.norm(way, axis=-1), _LOOK_M)[:, None]
        angle = np.arctan2(way[:, 1], way[:, 0])[:, None] + _TURNS
        step = reach[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        away = (people - start[:, None])[:, None]
        along = (step[:, :, None] * away).sum(-1) / np.maximum(reach[..., None] ** 2, 1e-12)
        passing = np.linalg.norm(away - np.clip(along, 0, 1)[..., None] * step[:, :, None], axis=-1)
        # Whoever is that close already must at least not come closer.
        clear = (passing >= np.minimum(np.linalg.norm(away, axis=-1) - 1e-9, gap_m)).all(-1)
        ends = start[:, None] + step
        clear[:, 1:] &= self._sees(start, ends[:, 1:])
        left = np.where(clear, np.linalg.norm(ends - target[:, None], axis=-1), np.inf)
        aside = ends[np.arange(len(ends)), left.argmin(1)]
        return np.where((clear[:, 0] | ~clear.any(1))[:, None], target, aside)

    def _last_nodes(self, goal: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """The goals, moved where they have to be, the nodes around [E, k] and the ways from there [E, k] [m]."""
        near = self._near_nodes(goal)
        bad = np.logical_not(self._sees(goal, self.nodes[near]).any(1))
        goal = np.where(bad[:, None], self.nodes[near[:, 0]], goal)
        seen = self._sees(goal, self.nodes[near])
        return goal, near, self._length_where(seen, goal, near)

    def _first_nodes(self, start: FloatArray) -> tuple[IntArray, FloatArray]:
        """The nodes around `start` [E, k] and the ways there [E, k] [m], inf for those that are not to be tried."""
        near = self._near_nodes(start)
        seen = self._sees(start, self.nodes[near])
        close = np.flatnonzero(np.logical_not(seen.any(1)))
        if len(close):
            seen[close] = self._ways_out(close, start[close], self.nodes[near[close]])
        return near, self._length_where(seen, start, near)

    def _ways_out(self, cells: IntArray, start: FloatArray, nodes: FloatArray) -> BoolArray:
        """Which nodes [c, k, 2] [m] those of `cells` [c] who stand too close to something should leave for, [c, k].

        The bumper stops any motion toward what is at its limit, so that the way has to lead away from that.
        """
        parts = (self._solid.centre, self._solid.half, self._solid.axis)
        solid = self._solid if self._offices == 1 else Footprints(*(part[:, cells] for part in parts))
        share = np.arange(1, _SAMPLES + 1)[:, None] / _SAMPLES
        step = (nodes - start[:, None])[:, :, None] * share
        found = solid.distance((start[:, None, None] + step).reshape(len(cells), -1, 2)).reshape(step.shape[:-1])
        wanted = solid.distance(start[:, None])[..., None] + _RISE * np.linalg.norm(step, axis=-1)
        lacking = np.maximum(np.minimum(wanted, self.keep_m) - found, 0).max(-1)
        return lacking <= lacking.min(-1, keepdims=True) + 1e-3

    def _shortest(
        self, first: IntArray, first_m: FloatArray, last: IntArray, last_m: FloatArray
    ) -> tuple[FloatArray, IntArray, IntArray]:
        """Length [E] [m] of the shortest way over the nodes around its ends, and its first and last node [E]."""
        cells = np.arange(len(first))
        between = self.distances[self._office(cells)[:, None, None], first[:, :, None], last[:, None]]
        total = (first_m[:, :, None] + between + last_m[:, None]).reshape(len(cells), -1)
        best = total.argmin(1)
        a, b = np.divmod(best, last.shape[1])
        return total[cells, best], first[cells, a], last[cells, b]

    def _walk(self, first: IntArray, last: IntArray) -> IntArray:
        """The nodes of the shortest ways [E, L] from `first` to `last`, both [E]; shorter ones repeat their last."""
        office = self._office(np.arange(len(first)))
        node, way = first, [first]
        while (node != last).any():
            beyond = self.distances[office[:, None], self._neighbours[node], last[:, None]]
            choice = (self._edge_m[office, node] + beyond).argmin(1)
            node = np.where(node == last, last, self._neighbours[node, choice])
            way.append(node)
        return np.stack(way, 1)

    def _near_nodes(self, places: FloatArray) -> IntArray:
        """The reachable nodes nearest to `places` [E, 2] [m], nearest first, [E, k]."""
        count = min(_NEAR_NODES, int(self.reachable.sum(-1).min()))
        return _nearest(self.nodes, self.reachable, np.ascontiguousarray(places), count)

    def _sees(self, start: FloatArray, ends: FloatArray) -> BoolArray:
        """Whether straight ways from `start` [E, 2] [m] to `ends` [E, P, 2] [m] are free, [E, P]."""
        return self._solid.free_run(np.broadcast_to(start[:, None], ends.shape), ends, self.keep_m)

    def _length_where(self, seen: BoolArray, place: FloatArray, nodes: IntArray) -> FloatArray:
        """Straight ways [E, k] [m] from `place` [E, 2] [m] to `nodes` [E, k], inf for those not seen."""
        return np.where(seen, np.linalg.norm(self.nodes[nodes] - place[:, None], axis=-1), np.inf)

    def _office(self, cells: IntArray) -> IntArray:
        return cells % self._offices

    def _edge_lengths(self, places: FloatArray, neighbours: IntArray) -> FloatArray:
        """Lengths [E or 1, N, 16] [m] of the ways to the neighbours [N, 16] of `places` [N, 2] [m], inf if not free."""
        half = len(_STEPS)
        ends = np.broadcast_to(places[neighbours], (self._offices, *neighbours.shape, 2))
        start = np.broadcast_to(places, ends[:, :, 0].shape)
        keep_m = self.keep_m + _SLACK_M
        ahead = np.stack([self._solid.free_run(start, ends[:, :, step], keep_m) for step in range(half)], -1)
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


@compiled
def _nearest(nodes: FloatArray, reachable: BoolArray, places: FloatArray, count: int) -> IntArray:
    """The `count` reachable nodes nearest to each place, nearest first, [E, count]."""
    near = np.empty((len(places), count), np.int64)
    squared = np.empty(count)
    for cell in range(len(places)):
        office = cell % len(reachable)
        squared[:] = np.inf
        for node in range(len(nodes)):
            dx, dy = nodes[node, 0] - places[cell, 0], nodes[node, 1] - places[cell, 1]
            away = dx * dx + dy * dy
            if reachable[office, node] and away < squared[-1]:
                rank = count - 1
                while rank > 0 and squared[rank - 1] > away:
                    squared[rank], near[cell, rank] = squared[rank - 1], near[cell, rank - 1]
                    rank -= 1
                squared[rank], near[cell, rank] = away, node
    return near


@compiled
def _to_nodes(first: IntArray, first_m: FloatArray, distances: NDArray[np.float32]) -> FloatArray:
    """`Paths.distance_to_nodes` over the first nodes [E, k] and the ways there [E, k] [m]."""
    lengths = np.full((len(first), distances.shape[-1]), np.inf)
    for cell in range(len(first)):
        for choice in range(first.shape[1]):
            if first_m[cell, choice] < np.inf:
                onward = distances[cell % len(distances), first[cell, choice]]
                for node in range(len(onward)):
                    lengths[cell, node] = min(lengths[cell, node], first_m[cell, choice] + onward[node])
    return lengths


@compiled
def _along(
    length: FloatArray,
    present: FloatArray,
    values: FloatArray,
    most_m: float,
    neighbours: IntArray,
    edge_m: NDArray[np.float32],
) -> FloatArray:
    """`Paths.along` over edges `edge_m` [E or 1, n, 16] to `neighbours` [n, 16]."""
    integrals = np.zeros(length.shape)
    for cell in range(len(length)):
        way, value, integral = length[cell], values[cell], integrals[cell]
        edges = edge_m[cell % len(edge_m)]
        wanted = np.flatnonzero(way < most_m)
        # The node before another one on its way is nearer to the start, so that it comes first.
        for node in wanted[np.argsort(way[wanted])]:
            parent, shortest = node, np.inf
            for edge in range(neighbours.shape[1]):
                through = way[neighbours[node, edge]] + edges[node, edge]
                if through < shortest:
                    parent, shortest = neighbours[node, edge], through
            if shortest > way[node] + 1e-4:
                # The way to this node comes straight from the start.
                integral[node] = way[node] * (present[cell] + value[node]) / 2
            else:
                integral[node] = integral[parent] + (way[node] - way[parent]) * (value[node] + value[parent]) / 2
    return integrals
