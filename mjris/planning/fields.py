"""Over all nodes of a graph: lengths of the ways from one place, and values along them."""

import heapq

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_ROUNDING_M = 1e-4
"""How far sums of the lengths of ways are off, at most."""


@compiled
def field(
    neighbours: IntArray,
    edge_m: NDArray[np.float32],
    first: IntArray,
    first_m: FloatArray,
    wanted: IntArray,
    most_m: float,
) -> FloatArray:
    """Lengths [n] [m] of the shortest ways to all nodes that begin with `first_m` [m] to the nodes `first`.

    Over edges [n, 16] of lengths `edge_m` [m] to `neighbours`, by Dijkstra's algorithm. It ends once all `wanted` nodes
    are known, if there are any, or at `most_m` [m]; what is not known by then is too long or inf.
    """
    lengths, left = np.full(len(neighbours), np.inf), len(wanted)
    queue = [(np.inf, 0) for _ in range(0)]  # empty, and of a type that Numba can tell
    for choice in range(len(first)):
        if first_m[choice] < lengths[first[choice]]:
            lengths[first[choice]] = first_m[choice]
            heapq.heappush(queue, (first_m[choice], first[choice]))
    while queue:
        so_far, node = heapq.heappop(queue)
        if so_far > most_m:
            break
        if so_far > lengths[node]:
            continue  # a shorter way was found meanwhile
        for other in wanted:
            if other == node:
                left -= 1
        if left == 0 and len(wanted):
            break
        for way in range(neighbours.shape[1]):
            beyond, through = neighbours[node, way], so_far + edge_m[node, way]
            if through < lengths[beyond]:
                lengths[beyond] = through
                heapq.heappush(queue, (through, beyond))
    return lengths


@compiled
def integrals_along(
    neighbours: IntArray,
    edge_m: NDArray[np.float32],
    length: FloatArray,
    present: FloatArray,
    values: FloatArray,
    most_m: float,
) -> FloatArray:
    """`Paths.along`."""
    integrals, nodes = np.zeros(length.shape), length.shape[1]
    parents, behind = np.empty(nodes, np.int64), np.empty(nodes, np.int64)
    for cell in range(len(length)):
        way, value, integral = length[cell], values[cell], integrals[cell]
        edges, known = edge_m[cell % len(edge_m)], way >= most_m
        for last in range(nodes):
            # Back along the way to what is known, which the start is to its first node, and from there on again.
            node, count = last, 0
            while not known[node]:
                known[node], parents[node] = True, _parent(neighbours, edges, way, node)
                behind[count], count = node, count + 1
                node = parents[node]
            for back in range(count - 1, -1, -1):
                node = behind[back]
                before = parents[node]
                if before == node:
                    integral[node] = way[node] * (present[cell] + value[node]) / 2
                else:
                    integral[node] = integral[before] + (way[node] - way[before]) * (value[node] + value[before]) / 2
    return integrals


@compiled
def _parent(neighbours: IntArray, edge_m: NDArray[np.float32], way_m: FloatArray, node: int) -> int:
    """The node before another one on its way, for the lengths of all ways [n]; itself if it is the first one."""
    parent, least = node, np.inf
    for edge in range(neighbours.shape[1]):
        through = way_m[neighbours[node, edge]] + edge_m[node, edge]
        if through < least:
            parent, least = neighbours[node, edge], through
    return node if least > way_m[node] + _ROUNDING_M else parent
