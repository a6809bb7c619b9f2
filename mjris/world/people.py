"""Random walks of the users: a Rayleigh distance in a uniform direction each slot, taken only where there is room."""

import math
from typing import NamedTuple

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import World
from mjris.jit.compiled import compiled
from mjris.world.footprints import Footprints, Rectangles, entry
from mjris.world.office import PERSON_RADIUS_M, Office, hull_radius

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class Walkers(NamedTuple):
    """The people of E cells in the middle of a slot."""

    xy: FloatArray
    """Where they are [E, K, 2] [m], in MuJoCo's own memory."""
    start: FloatArray
    """Where they set out [E, K, 2] [m]."""
    step: FloatArray
    """The way that they mean to go in the slot [E, K, 2] [m]."""
    walked: IntArray
    """How many ticks' ways of it they have walked [E, K]."""
    ticks: int
    """Ticks of a slot."""
    from_rover_m: float
    """Nobody steps closer to the rover's middle than this [m]."""


class Crowd:
    """The people of E cells, as mocap bodies of one batch."""

    def __init__(self, config: World, office: Office, batch: Batch, solid: Footprints):
        self._clearance_m = config.clearance_m
        self._solid = solid
        self._quat = batch.bind("mocap_quat")[:, office.mocap_ids]
        xy = batch.bind("mocap_pos")[:, office.mocap_ids, :2]
        self.walkers = Walkers(
            xy=xy,
            start=xy.copy(),
            step=np.zeros(xy.shape),
            walked=np.zeros(xy.shape[:2], np.int64),
            ticks=config.ticks_per_slot,
            from_rover_m=PERSON_RADIUS_M + hull_radius(office.config) + config.clearance_m,
        )

    @property
    def xy(self) -> FloatArray:
        """Positions [E, K, 2] [m]."""
        return self.walkers.xy.copy()

    def place(self, cells: IntArray, xy: FloatArray) -> None:
        """Stand the people of some cells at `xy` [n, K, 2] [m]."""
        self.walkers.xy[cells] = xy

    def plan(self, distance: FloatArray, direction: FloatArray) -> None:
        """Choose the slot's steps, [E, K] [m] and [E, K] [rad].

        Whoever would come too close to something solid, or to the way of somebody else, stays.
        """
        _plan(self.walkers, self._quat, self._solid.arrays, distance, direction, self._clearance_m)

    def walk(self, rover_xy: FloatArray) -> FloatArray:
        """One tick of everyone's step, except who would come too close to the rover at `rover_xy` [E, 2] [m].

        Returns the distance between each rover's middle and the nearest person's [E] [m].
        """
        return _walk(self.walkers, rover_xy)


@compiled
def walk(people: Walkers, cell: int, rover_x: float, rover_y: float) -> float:
    """`Crowd.walk` in one cell."""
    nearest = np.inf
    for k in range(people.xy.shape[1]):
        away_x, away_y = people.xy[cell, k, 0] - rover_x, people.xy[cell, k, 1] - rover_y
        step_x, step_y = people.step[cell, k, 0], people.step[cell, k, 1]
        u, v = step_x / people.ticks, step_y / people.ticks
        # Whom the rover has come close to may still walk away from it.
        nearing = -(away_x * u + away_y * v)
        share = 0.0 if nearing <= 0 else min(nearing / (u * u + v * v), 1.0)
        passing_x, passing_y = away_x + share * u, away_y + share * v
        if nearing <= 0 or passing_x * passing_x + passing_y * passing_y >= people.from_rover_m**2:
            people.walked[cell, k] += 1
        # From the start, not from the last place: ticks lead to the same number as one leap.
        share = people.walked[cell, k] / people.ticks
        people.xy[cell, k, 0] = people.start[cell, k, 0] + share * step_x
        people.xy[cell, k, 1] = people.start[cell, k, 1] + share * step_y
        away_x, away_y = people.xy[cell, k, 0] - rover_x, people.xy[cell, k, 1] - rover_y
        nearest = min(nearest, away_x * away_x + away_y * away_y)
    return math.sqrt(nearest)


@compiled
def _walk(people: Walkers, rover_xy: FloatArray) -> FloatArray:
    nearest = np.empty(len(rover_xy))
    for cell in range(len(rover_xy)):
        nearest[cell] = walk(people, cell, rover_xy[cell, 0], rover_xy[cell, 1])
    return nearest


@compiled
def _plan(
    people: Walkers,
    quat: FloatArray,
    solid: Rectangles,
    distance: FloatArray,
    direction: FloatArray,
    clearance_m: float,
) -> None:
    cells, users = distance.shape
    apart = np.empty(users)
    for cell in range(cells):
        office = cell % solid[0].shape[1]
        start, step = people.start[cell], people.step[cell]
        start[:] = people.xy[cell]
        people.walked[cell] = 0
        for k in range(users):
            u, v = distance[cell, k] * math.cos(direction[cell, k]), distance[cell, k] * math.sin(direction[cell, k])
            free = entry(solid, office, start[k, 0], start[k, 1], u, v, PERSON_RADIUS_M + clearance_m) == np.inf
            step[k, 0], step[k, 1] = (u, v) if free else (0.0, 0.0)
        apart[:] = np.inf
        for k in range(users):
            for other in range(k):
                between = segment_distance(start[k], step[k], start[other], step[other])
                apart[k], apart[other] = min(apart[k], between), min(apart[other], between)
        for k in range(users):
            if apart[k] < 2 * PERSON_RADIUS_M + clearance_m:
                step[k] = 0
            elif step[k, 0] != 0 or step[k, 1] != 0:
                quat[cell, k] = 0
                quat[cell, k, 0], quat[cell, k, 3] = math.cos(direction[cell, k] / 2), math.sin(direction[cell, k] / 2)


@compiled
def segment_distance(start: FloatArray, step: FloatArray, other_start: FloatArray, other_step: FloatArray) -> float:
    """Distance between two ways in the plane [m], each with a start and a step [2] [m].

    The closest points of two segments: the unconstrained optimum on one, clamped, then the best answer on the other,
    clamped, and the best answer to that (C. Ericson, Real-Time Collision Detection, 5.1.9).
    """
    ux, uy = step
    vx, vy = other_step
    rx, ry = start[0] - other_start[0], start[1] - other_start[1]
    uu, vv, uv = ux * ux + uy * uy, vx * vx + vy * vy, ux * vx + uy * vy
    ur, vr = ux * rx + uy * ry, vx * rx + vy * ry
    s = _share(uv * vr - ur * vv, uu * vv - uv * uv)
    t = _share(uv * s + vr, vv)
    s = _share(uv * t - ur, uu)
    return math.hypot(rx + s * ux - t * vx, ry + s * uy - t * vy)


@compiled
def _share(numerator: float, denominator: float) -> float:
    """The quotient within 0 and 1, zero where a segment is a point or both are parallel."""
    return 0.0 if denominator <= 1e-12 else min(max(numerator / denominator, 0.0), 1.0)
