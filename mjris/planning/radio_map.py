"""The radio map: what a place is worth to the RIS, predicted from the layout and where the users stand."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.planning import prediction
from mjris.planning.sight_map import Seen, write_obstacles
from mjris.radio import equations
from mjris.radio.serving import System
from mjris.radio.tables import LinkTable
from mjris.world.facing import bisectors

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]


class Ground(NamedTuple):
    """What predictions for places of E cells follow from."""

    table: LinkTable
    system: System
    arrays: prediction.Arrays
    ends: FloatArray
    """Users and, last, AP [E, K + 1, 3] [m]."""
    aims: FloatArray
    """What panels face between [E, ., 2] [m], see `Simulator.aims`."""
    heading_rad: float
    """Where they face instead, NaN if nowhere else."""
    seen: Seen
    """Obstacles from there."""
    beside: prediction.Beside
    """What reaches users without the rover's panel."""
    qos_penalty: float
    """λ of eq. (R)."""


def penalised(rates_bps: FloatArray, qos_bps: float, penalty: float) -> FloatArray:
    """Sum rate [...] of rates [..., K] [bit/s], divided by λ where any user misses QoS, eq. (R)."""
    flat = np.ascontiguousarray(rates_bps).reshape(-1, rates_bps.shape[-1])
    return _all_penalised(flat, qos_bps, penalty).reshape(rates_bps.shape[:-1])


@compiled
def best(
    here: FloatArray,
    nodes: FloatArray,
    way_m: FloatArray,
    along: FloatArray,
    present: FloatArray,
    values: FloatArray,
    horizon_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Where to drive [E, 2] [m] for the largest mean value on a way of `horizon_m` [m], and that mean [E].

    For ways to nodes [E, n] [m], integrals of the value `along` them, and values here [E] and there [E, n].
    """
    goal, mean = here.copy(), present.copy()
    for e in range(len(here)):
        for node in range(len(nodes)):
            if way_m[e, node] < horizon_m:
                then = (along[e, node] + (horizon_m - way_m[e, node]) * values[e, node]) / horizon_m
                if then > mean[e]:
                    goal[e], mean[e] = nodes[node], then
    return goal, mean


@compiled
def values_at(ground: Ground, places: FloatArray, wanted: BoolArray) -> FloatArray:
    """Values [E, P] [bit/s] of those `places` [E or 1, P, 2] [m] that are wanted [E, P], -inf of the others."""
    values, users = np.full(wanted.shape, -np.inf), ground.beside.coherent.shape[1]
    for e in range(len(values)):
        here = places[e % len(places)][wanted[e]]
        gains, rates = np.empty((users + 1, len(here))), np.empty((users, len(here)))
        _link_gains(ground, e, here, gains)
        beside = ground.beside.coherent[e], ground.beside.scattered[e]
        prediction.with_panel(ground.system, ground.arrays, *beside, gains[users], gains[:users])
        prediction.predict(ground.system, ground.arrays, gains[:users], rates)
        at = 0
        for p in range(len(wanted[e])):
            if wanted[e, p]:
                values[e, p] = _penalised(rates[:, at], ground.system.qos_bps, ground.qos_penalty)
                at += 1
    return values


@compiled
def _link_gains(ground: Ground, cell: int, places: FloatArray, gains: FloatArray) -> None:
    """Write the power gains of the links RIS–users and, last, AP–RIS to `gains` [K + 1, P], patterns included.

    For a panel in a cell at `places` [P, 2] [m].
    """
    ends = ground.ends[cell]
    x, y = places[:, 0].copy(), places[:, 1].copy()
    forward_x, forward_y = np.empty(len(x)), np.empty(len(x))
    behind = np.empty(len(x))
    if math.isnan(ground.heading_rad):
        bisectors(ground.aims[cell], x, y, forward_x, forward_y)
    else:
        forward_x[:], forward_y[:] = math.cos(ground.heading_rad), math.sin(ground.heading_rad)
    for end in range(len(ends)):
        write_obstacles(ground.seen, cell, end, x, y, behind)
        _gains(ground.table, ends[end], ground.seen.high_m, x, y, forward_x, forward_y, behind, gains[end])


@compiled
def _gains(
    table: LinkTable,
    end: FloatArray,
    panel_height_m: float,
    x: FloatArray,
    y: FloatArray,
    forward_x: FloatArray,
    forward_y: FloatArray,
    behind: FloatArray,
    gains: FloatArray,
) -> None:
    """Write the gains [P] of the links from one end [3] [m], with the obstacles `behind` which panels see it [P]."""
    end_x, end_y, rise = end[0], end[1], end[2] - panel_height_m
    for p in range(len(x)):
        to_x, to_y = end_x - x[p], end_y - y[p]
        squared = to_x * to_x + to_y * to_y + rise * rise
        facing = forward_x[p] * forward_x[p] + forward_y[p] * forward_y[p]
        cosine = (forward_x[p] * to_x + forward_y[p] * to_y) / math.sqrt(max(squared * facing, 1e-24))
        gain_db = equations.element_gain_db(table, cosine) - equations.path_loss_db(table, squared, behind[p])
        gains[p] = equations.db_to_linear(gain_db)


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
