"""Random walks of the users: a Rayleigh distance in a uniform direction each slot, taken only where there is room."""

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import World
from mjris.world.footprints import Footprints
from mjris.world.office import PERSON_RADIUS_M, Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class Crowd:
    """The people of E cells, as mocap bodies of one batch."""

    def __init__(self, config: World, office: Office, batch: Batch, solid: Footprints, rover_radius_m: float):
        self._config = config
        self._solid = solid
        self._mocap_pos = batch.bind("mocap_pos")
        self._mocap_quat = batch.bind("mocap_quat")
        self._ids = office.mocap_ids
        self._from_rover = PERSON_RADIUS_M + rover_radius_m + config.clearance_m
        self._xy = np.zeros((batch.nsim, config.num_users, 2))
        self._start = np.zeros_like(self._xy)
        self._step = np.zeros_like(self._xy)
        self._walked = np.zeros((batch.nsim, config.num_users), np.int64)

    @property
    def xy(self) -> FloatArray:
        """Positions [E, K, 2] [m]."""
        return self._xy.copy()

    def place(self, cells: IntArray, xy: FloatArray) -> None:
        """Stand the people of some cells at `xy` [n, K, 2] [m]."""
        self._xy[cells] = xy
        self._step[cells] = 0
        self._mocap_pos[:, self._ids, :2] = self._xy

    def plan(self, distance: FloatArray, direction: FloatArray) -> None:
        """Choose the slot's steps, [E, K] [m] and [E, K] [rad].

        Whoever would come too close to something solid, or to the way of somebody else, stays.
        """
        step = distance[..., None] * np.stack([np.cos(direction), np.sin(direction)], -1)
        room = self._solid.free_run(self._xy, self._xy + step, PERSON_RADIUS_M + self._config.clearance_m)
        step = np.where(room[..., None], step, 0)
        apart = _segment_distance(self._xy, step)
        own = np.arange(apart.shape[1])
        apart[:, own, own] = np.inf
        step = np.where((apart.min(-1) >= 2 * PERSON_RADIUS_M + self._config.clearance_m)[..., None], step, 0)
        self._start, self._step = self._xy.copy(), step
        self._walked[:] = 0
        half = direction / 2
        walking = np.logical_or(step[..., 0] != 0, step[..., 1] != 0)
        facing = np.stack([np.cos(half), np.zeros_like(half), np.zeros_like(half), np.sin(half)], -1)
        self._mocap_quat[:, self._ids] = np.where(walking[..., None], facing, self._mocap_quat[:, self._ids])

    def stride_m(self) -> FloatArray:
        """How far everyone means to walk in this slot [E, K] [m]."""
        return np.sqrt(_squared_length(self._step))

    def walk(self, cells: IntArray, rover_xy: FloatArray) -> None:
        """One tick of everyone's step in some cells, except who would come too close to the rover there [n, 2] [m]."""
        ticks = self._config.ticks_per_slot
        away = self._xy[cells] - rover_xy[:, None]
        gap_now, gap = _squared_length(away), _squared_length(away + self._step[cells] / ticks)
        # Whom the rover has come close to may still walk away from it.
        self._walked[cells] += np.logical_or(gap >= self._from_rover**2, gap > gap_now)
        # From the start, not from the last place: ticks lead to the same number as one leap.
        self._move(cells, self._start[cells] + self._walked[cells][..., None] / ticks * self._step[cells])

    def arrive(self, cells: IntArray) -> None:
        """Everyone's whole step at once, in cells where the rover is far."""
        self._move(cells, self._start[cells] + self._step[cells])

    def _move(self, cells: IntArray, xy: FloatArray) -> None:
        self._xy[cells] = xy
        self._mocap_pos[cells[:, None], self._ids, :2] = xy


def _segment_distance(start: FloatArray, step: FloatArray) -> FloatArray:
    """Distance between the ways of all pairs of people, [E, K, K] [m], for `start` and `step` [E, K, 2] [m].

    The closest points of two segments: the unconstrained optimum on one, clamped, then the best answer on the other,
    clamped, and the best answer to that (C. Ericson, Real-Time Collision Detection, 5.1.9).
    """
    ux, uy = step[:, :, None, 0], step[:, :, None, 1]
    vx, vy = step[:, None, :, 0], step[:, None, :, 1]
    rx = start[:, :, None, 0] - start[:, None, :, 0]
    ry = start[:, :, None, 1] - start[:, None, :, 1]
    uu, vv, uv = ux * ux + uy * uy, vx * vx + vy * vy, ux * vx + uy * vy
    ur, vr = ux * rx + uy * ry, vx * rx + vy * ry
    determinant = uu * vv - uv * uv
    s = np.clip(_ratio(uv * vr - ur * vv, determinant), 0, 1)
    t = np.clip(_ratio(uv * s + vr, vv), 0, 1)
    s = np.clip(_ratio(uv * t - ur, uu), 0, 1)
    dx, dy = rx + s * ux - t * vx, ry + s * uy - t * vy
    return np.sqrt(dx * dx + dy * dy)


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """The quotient, zero where a segment is a point or both are parallel."""
    degenerate = denominator <= 1e-12
    return np.where(degenerate, 0, numerator / np.where(degenerate, 1, denominator))


def _squared_length(vector: FloatArray) -> FloatArray:
    x, y = vector[..., 0], vector[..., 1]
    return x * x + y * y
