"""Ways over a graph of free places, compiled cell by cell: where they begin and end, and what is in sight of them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.planning.fields import field
from mjris.world.footprints import Rectangles, gap, is_free, near

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SAMPLES = 12
"""Points of the way to a node at which a rover that stands too close to something looks."""
_RISE = 0.2
"""Such a rover is to gain this much distance per distance driven."""
_OUT_SLACK_M = 1e-3
"""How much worse than the best a way out may be."""
_LOOK_M = 1.0
"""How far ahead a rover looks for people who stand in its way."""
_TURNS = np.radians([0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75, 90, -90])
"""Turns with which it tries to drive around them."""


class Graph(NamedTuple):
    """Free places of one office or of one a cell (G), and the ways between them."""

    nodes: FloatArray
    """[n, 2] [m]"""
    reachable: BoolArray
    """Which of them there are in each office [G, n]."""
    neighbours: IntArray
    """Of every node [n, 16]."""
    edge_m: NDArray[np.float32]
    """Lengths of the ways to the neighbours [G, n, 16] [m], inf where there is none."""
    distances: NDArray[np.float32]
    """Lengths of the shortest ways between all nodes [G, n, n] [m], or [G, 0, 0]: worked out when they are needed."""
    solid: Rectangles
    keep_m: float
    """What ways keep from everything solid [m]."""
    tried: int
    """How many nodes around a place are tried as the first or last one of its way."""


@compiled
def lengths_to_nodes(graph: Graph, start: FloatArray, most_m: float) -> FloatArray:
    """`Paths.distance_to_nodes`."""
    lengths, nobody = np.full((len(start), len(graph.nodes)), np.inf), np.empty(0, np.int64)
    for cell in range(len(start)):
        office = cell % len(graph.distances)
        first, first_m = first_nodes(graph, office, start[cell, 0], start[cell, 1])
        if not _tabled(graph):
            lengths[cell] = _field(graph, office, first, first_m, nobody, most_m)
            continue
        for choice in range(len(first)):
            if first_m[choice] < np.inf:
                onward = graph.distances[office, first[choice]]
                for node in range(len(onward)):
                    lengths[cell, node] = min(lengths[cell, node], first_m[choice] + onward[node])
    return lengths


@compiled
def lengths(graph: Graph, start: FloatArray, goal: FloatArray) -> FloatArray:
    """`Paths.distance`."""
    found = np.empty(len(start))
    for cell in range(len(start)):
        office = cell % len(graph.distances)
        x, y = start[cell]
        goal_x, goal_y, last, last_m = last_nodes(graph, office, goal[cell, 0], goal[cell, 1])
        if _sees(graph, office, x, y, goal_x, goal_y):
            found[cell] = math.hypot(goal_x - x, goal_y - y)
            continue
        first, first_m = first_nodes(graph, office, x, y)
        if _tabled(graph):
            found[cell], _, _ = shortest(graph, office, first, first_m, last, last_m)
        else:
            onward = _field(graph, office, last, last_m, first[first_m < np.inf], np.inf)
            found[cell] = (first_m + onward[first]).min()
    return found


@compiled
def next_places(graph: Graph, start: FloatArray, goal: FloatArray) -> FloatArray:
    """`Paths.toward`."""
    places = np.empty(start.shape)
    for cell in range(len(start)):
        office = cell % len(graph.distances)
        x, y = start[cell]
        goal_x, goal_y, last, last_m = last_nodes(graph, office, goal[cell, 0], goal[cell, 1])
        if _sees(graph, office, x, y, goal_x, goal_y):
            places[cell, 0], places[cell, 1] = goal_x, goal_y
            continue
        first, first_m = first_nodes(graph, office, x, y)
        tabled, end, lengths = _tabled(graph), -1, first_m
        if tabled:
            _, node, end = shortest(graph, office, first, first_m, last, last_m)
        else:
            lengths = _field(graph, office, last, last_m, first[first_m < np.inf], np.inf)
            node = first[(first_m + lengths[first]).argmin()]
        # The first node is where to go when nothing is in free sight, as it is for a rover too close to something.
        places[cell] = graph.nodes[node]
        for _ in range(len(graph.nodes)):  # no way has more nodes, whatever numbers come in
            if node == end:
                break
            node = next_node(graph, office, node, end) if tabled else _nearer(graph, office, node, lengths)
            if node < 0:
                break
            if _sees(graph, office, x, y, graph.nodes[node, 0], graph.nodes[node, 1]):
                places[cell] = graph.nodes[node]
    return places


@compiled
def around_people(graph: Graph, start: FloatArray, target: FloatArray, people: FloatArray, gap_m: float) -> FloatArray:
    """`Paths.around`."""
    places = target.copy()
    for cell in range(len(start)):
        x, y = start[cell]
        to_x, to_y = target[cell, 0] - x, target[cell, 1] - y
        reach, straight = min(math.hypot(to_x, to_y), _LOOK_M), math.atan2(to_y, to_x)
        least = np.inf
        for turn in _TURNS:
            u, v = reach * math.cos(straight + turn), reach * math.sin(straight + turn)
            if _passes(people[cell], x, y, u, v, gap_m):
                if turn == 0:
                    break
                left = math.hypot(u - to_x, v - to_y)
                # Of equally good ways to both sides, rounding is not to choose.
                if left < least - 1e-9 and _sees(graph, cell % len(graph.distances), x, y, x + u, y + v):
                    least = left
                    places[cell, 0], places[cell, 1] = x + u, y + v
    return places


@compiled
def _passes(people: FloatArray, x: float, y: float, u: float, v: float, gap_m: float) -> bool:
    """Whether a way (u, v) from (x, y) keeps a gap to all people [K, 2]; who is closer must not come closer still."""
    for k in range(len(people)):
        away_x, away_y = people[k, 0] - x, people[k, 1] - y
        along = min(max((u * away_x + v * away_y) / max(u * u + v * v, 1e-12), 0.0), 1.0)
        passing = math.hypot(away_x - along * u, away_y - along * v)
        if passing < min(math.hypot(away_x, away_y) - 1e-9, gap_m):
            return False
    return True


@compiled
def last_nodes(graph: Graph, office: int, x: float, y: float) -> tuple[float, float, IntArray, FloatArray]:
    """A goal, moved to the nearest node if it is in sight of none; the nodes around, and the ways from there [m].

    The ways are inf for nodes out of sight.
    """
    near = _nearest(graph, office, x, y)
    away = _lengths_in_sight(graph, office, x, y, near)
    if away.min() == np.inf:
        x, y = graph.nodes[near[0]]
        away = _lengths_in_sight(graph, office, x, y, near)
    return x, y, near, away


@compiled
def first_nodes(graph: Graph, office: int, x: float, y: float) -> tuple[IntArray, FloatArray]:
    """The nodes around a place, and the ways there [m], inf for those that are not to be tried."""
    near = _nearest(graph, office, x, y)
    away = _lengths_in_sight(graph, office, x, y, near)
    return near, _ways_out(graph, office, x, y, near) if away.min() == np.inf else away


@compiled
def _ways_out(graph: Graph, office: int, x: float, y: float, near: IntArray) -> FloatArray:
    """The ways [m] to those nodes that a place too close to something should be left for, inf for others.

    The bumper stops any motion toward what is at its limit, so that the way has to lead away from that.
    """
    lacking, away, here = np.zeros(len(near)), np.empty(len(near)), gap(graph.solid, office, x, y)
    for choice in range(len(near)):
        u, v = graph.nodes[near[choice], 0] - x, graph.nodes[near[choice], 1] - y
        away[choice] = math.hypot(u, v)
        for sample in range(1, _SAMPLES + 1):
            share = sample / _SAMPLES
            wanted = min(here + _RISE * share * away[choice], graph.keep_m)
            lacking[choice] = max(lacking[choice], wanted - gap(graph.solid, office, x + share * u, y + share * v))
    return np.where(lacking <= lacking.min() + _OUT_SLACK_M, away, np.inf)


@compiled
def shortest(
    graph: Graph, office: int, first: IntArray, first_m: FloatArray, last: IntArray, last_m: FloatArray
) -> tuple[float, int, int]:
    """Length [m] of the shortest way over the nodes around its ends, and its first and last node."""
    least, start, end = np.inf, first[0], last[0]
    for a in range(len(first)):
        for b in range(len(last)):
            length = first_m[a] + graph.distances[office, first[a], last[b]] + last_m[b]
            if length < least:
                least, start, end = length, first[a], last[b]
    return least, start, end


@compiled
def next_node(graph: Graph, office: int, node: int, end: int) -> int:
    """The node after another one on the shortest way to `end`."""
    chosen, least = node, np.inf
    for edge in range(graph.neighbours.shape[1]):
        beyond = graph.edge_m[office, node, edge] + graph.distances[office, graph.neighbours[node, edge], end]
        if beyond < least:
            chosen, least = graph.neighbours[node, edge], beyond
    return chosen


@compiled
def _nearer(graph: Graph, office: int, node: int, lengths: FloatArray) -> int:
    """The node after another one on the way whose rest has `lengths` [n] [m], -1 where it ends."""
    chosen, least = -1, np.inf
    for edge in range(graph.neighbours.shape[1]):
        beyond = lengths[graph.neighbours[node, edge]] + graph.edge_m[office, node, edge]
        if beyond < least:
            chosen, least = graph.neighbours[node, edge], beyond
    return chosen if least <= lengths[node] else -1


@compiled
def _tabled(graph: Graph) -> bool:
    return graph.distances.shape[1] > 0


@compiled
def _field(
    graph: Graph, office: int, first: IntArray, first_m: FloatArray, wanted: IntArray, most_m: float
) -> FloatArray:
    return field(graph.neighbours, graph.edge_m[office], first, first_m, wanted, most_m)


@compiled
def _sees(graph: Graph, office: int, x: float, y: float, end_x: float, end_y: float) -> bool:
    return is_free(graph.solid, office, x, y, end_x - x, end_y - y, graph.keep_m)


@compiled
def _lengths_in_sight(graph: Graph, office: int, x: float, y: float, nodes: IntArray) -> FloatArray:
    """Straight ways [m] from a place to some nodes, inf for those out of sight."""
    lengths = np.empty(len(nodes))
    for choice in range(len(nodes)):
        lengths[choice] = math.hypot(graph.nodes[nodes[choice], 0] - x, graph.nodes[nodes[choice], 1] - y)
    # No way leads past what is further away than the furthest node.
    solid = near(graph.solid, office, x, y, lengths.max() + 2 * graph.keep_m)
    for choice in range(len(nodes)):
        u, v = graph.nodes[nodes[choice], 0] - x, graph.nodes[nodes[choice], 1] - y
        if not is_free(solid, 0, x, y, u, v, graph.keep_m):
            lengths[choice] = np.inf
    return lengths


@compiled
def _nearest(graph: Graph, office: int, x: float, y: float) -> IntArray:
    """The reachable nodes nearest to a place, nearest first; of a place that no number names, the first node."""
    near, squared = np.zeros(graph.tried, np.int64), np.full(graph.tried, np.inf)
    for node in range(len(graph.nodes)):
        dx, dy = graph.nodes[node, 0] - x, graph.nodes[node, 1] - y
        away = dx * dx + dy * dy
        if away < squared[-1] and graph.reachable[office, node]:
            rank = graph.tried - 1
            while rank > 0 and squared[rank - 1] > away:
                squared[rank], near[rank] = squared[rank - 1], near[rank - 1]
                rank -= 1
            squared[rank], near[rank] = away, node
    return near
