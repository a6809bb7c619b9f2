"""The rovers of all cells: poses, panels, and the bumper that stops any drive."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import World
from mjris.jit.compiled import compiled
from mjris.world.footprints import Footprints, Rectangles, gap
from mjris.world.office import PERSON_RADIUS_M, Office, feeler_reach, hull_radius
from mjris.world.people import Crowd

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Motion:
    """What happened in a slot: smallest hull distance met [E] [m] and penetrating contacts [E]."""

    clearance_m: FloatArray
    collisions: IntArray


class Bumper(NamedTuple):
    """What the bumpers of E rovers feel."""

    reading: FloatArray
    """Contacts: whether there is one, its distance [m] and normal (3); [E, C, 5], in MuJoCo's own memory."""
    fresh: NDArray[np.bool_]
    """Whether nothing that can be felt has moved since it was read [E]."""
    nearest_m: FloatArray
    """Smallest distance felt in the slot [E] [m]."""
    penetrations: IntArray
    """Penetrating contacts felt in the slot [E]."""
    keep_m: float
    """The rover stops this far from what it feels [m]."""


class Fleet(ABC):
    """The rovers of E cells on one batch: poses, panels and bumpers. How they move is up to the drive."""

    def __init__(self, config: World, office: Office, batch: Batch, solid: Footprints, crowd: Crowd):
        """`solid` and `crowd` are all that the rovers can meet."""
        self._config = config
        self._batch = batch
        self._solid = solid
        self._crowd = crowd
        self._tick_s = config.slot_s / config.ticks_per_slot
        self.hull_radius_m = hull_radius(office.config)
        self._feeler_m = feeler_reach(office.config)
        start = office.rover_qpos
        self._qpos = batch.bind("qpos")
        self._qvel = batch.bind("qvel")
        self._pose = self._qpos[:, start : start + 7]
        self._pan = self._qpos[:, office.pan_qpos]
        self._ctrl = batch.bind("ctrl")
        self._rest = office.model.qpos0.copy()
        self._bumper = Bumper(
            reading=batch.bind("sensordata")[:, office.bumper].reshape(batch.nsim, -1, 5),
            fresh=np.zeros(batch.nsim, np.bool_),
            nearest_m=np.full(batch.nsim, np.inf),
            penetrations=np.zeros(batch.nsim, np.int64),
            keep_m=config.bumper_m,
        )

    @property
    def xy(self) -> FloatArray:
        """Positions [E, 2] [m]."""
        return self._pose[:, :2].copy()

    @property
    def heading(self) -> FloatArray:
        """Directions of the rovers' fronts [E] [rad]."""
        return _headings(self._pose)

    @property
    def panel_heading(self) -> FloatArray:
        """Directions that the panels face [E] [rad]."""
        return self.heading + self._pan

    def place(self, cells: IntArray, xy: FloatArray, heading: FloatArray) -> None:
        """Stand the rovers of some cells at rest: `xy` [n, 2] [m], `heading` [n] [rad], panels straight ahead."""
        self._qpos[cells] = self._rest
        self._qvel[cells] = 0
        self._ctrl[cells] = 0
        self._pose[cells, :2] = xy
        quat = np.zeros((len(cells), 4))
        quat[:, 0], quat[:, 3] = np.cos(heading / 2), np.sin(heading / 2)
        self._pose[cells, 3:7] = quat
        self._bumper.fresh[cells] = False

    @abstractmethod
    def face(self, direction: FloatArray) -> None:
        """Turn the panels toward world directions [E] [rad]."""

    def move(self, displacement: FloatArray, on_tick: Callable[[], None] | None = None) -> Motion:
        """One slot of rovers and people: rovers by `displacement` [E, 2] [m]; `on_tick` is called after every tick."""
        self._bumper.nearest_m[:], self._bumper.penetrations[:] = np.inf, 0
        self._drive(displacement, on_tick)
        clearance = self.clearance()
        self._feel(np.flatnonzero(clearance < self._feeler_m))
        return Motion(np.minimum(self._bumper.nearest_m, clearance), self._bumper.penetrations.copy())

    @abstractmethod
    def _drive(self, displacement: FloatArray, on_tick: Callable[[], None] | None) -> None:
        """`move`, by the drive."""

    def clearance(self) -> FloatArray:
        """Distance between the rover's hull and the nearest furniture, wall or person [E] [m]."""
        return _clearances(self._solid.arrays, self._crowd.walkers.xy, self._pose) - self.hull_radius_m

    def _feel(self, cells: IntArray) -> None:
        """Have the bumpers of some cells read, and record what they feel."""
        if not len(cells):
            return
        stale = cells[~self._bumper.fresh[cells]]
        if len(stale):
            self._batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS, ids=stale)
        self._bumper.fresh[stale] = True
        _record(self._bumper, cells)


@compiled
def _record(bumper: Bumper, cells: IntArray) -> None:
    """Keep the smallest distance and the penetrations of the slot."""
    for cell in cells:
        for found, distance in bumper.reading[cell, :, :2]:
            if found > 0:
                bumper.nearest_m[cell] = min(bumper.nearest_m[cell], distance)
                bumper.penetrations[cell] += distance < 0


@compiled
def free_travel(bumper: Bumper, cell: int, unit_x: float, unit_y: float) -> float:
    """How far a rover may move along a unit vector before it is within keep_m of a contact [m].

    A contact's normal is that of a plane which separates the hull from a convex obstacle, so that a shorter
    move along the vector cannot touch it.
    """
    travel = np.inf
    for found, distance, normal_x, normal_y, _ in bumper.reading[cell]:
        closing = normal_x * unit_x + normal_y * unit_y
        if found > 0 and closing > 1e-9:
            travel = min(travel, max(distance - bumper.keep_m, 0.0) / closing)
    return travel


@compiled
def heading_of(pose: FloatArray) -> float:
    """Direction of a rover's front, from its pose [7], from its quaternion [rad]."""
    w, x, y, z = pose[3:7]
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


@compiled
def _headings(poses: FloatArray) -> FloatArray:
    headings = np.empty(len(poses))
    for cell in range(len(poses)):
        headings[cell] = heading_of(poses[cell])
    return headings


@compiled
def _clearances(solid: Rectangles, people: FloatArray, pose: FloatArray) -> FloatArray:
    """Distance of the rovers' middles to the nearest furniture, wall or person [E] [m]."""
    clearances = np.empty(len(pose))
    for cell in range(len(pose)):
        x, y = pose[cell, 0], pose[cell, 1]
        nearest = gap(solid, cell % solid[0].shape[1], x, y)
        for k in range(people.shape[1]):
            nearest = min(nearest, math.hypot(people[cell, k, 0] - x, people[cell, k, 1] - y) - PERSON_RADIUS_M)
        clearances[cell] = nearest
    return clearances
