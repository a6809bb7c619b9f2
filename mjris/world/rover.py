"""The rovers of all cells: two drives toward the commanded place, and the bumper that stops both."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from abc import ABC, abstractmethod

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import World
from mjris.world.office import Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_WHEEL_RADIUS_M = 0.08
_HALF_TRACK_M = 0.17
_APPROACH_PER_S = 4.0
"""Speed per distance left, so that the rover slows down before its target [1/s]."""
_TURN_PER_S = 4.0
"""Turning rate per heading error [1/s]."""
_MAX_TURN_RADPS = 3.0
_ARRIVED_M = 0.01
_SPEED_SHARE = 0.97
"""Wheel commands stay this far below v_max, for the servo's ripple."""


class Fleet(ABC):
    """The rovers of E cells on one batch: poses, panels and bumpers. How they move is up to the drive."""

    def __init__(self, config: World, office: Office, batch: Batch):
        self._config = config
        self._batch = batch
        self._tick_s = config.slot_s / config.ticks_per_slot
        start = office.rover_qpos
        self._qpos = batch.bind("qpos")
        self._qvel = batch.bind("qvel")
        self._pose = self._qpos[:, start : start + 7]
        self._pan = self._qpos[:, office.pan_qpos]
        self._ctrl = batch.bind("ctrl")
        self._bumper = batch.bind("sensordata")[:, office.bumper].reshape(batch.nsim, -1, 5)
        self._rest = office.model.qpos0.copy()
        self._sensed = np.zeros(batch.nsim, np.bool_)
        self.nearest_m = np.full(batch.nsim, np.inf)
        """Smallest distance that each bumper has felt in the slot [E] [m]."""
        self.penetrations = np.zeros(batch.nsim, np.int64)
        """Penetrating contacts that each bumper has felt in the slot [E]."""

    @property
    def xy(self) -> FloatArray:
        """Positions [E, 2] [m]."""
        return self._pose[:, :2].copy()

    @property
    def heading(self) -> FloatArray:
        """Directions of the rovers' fronts [E] [rad]."""
        return self._heading(slice(None))

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
        self._turn_to(cells, heading)
        self.forget(cells)

    @abstractmethod
    def face(self, direction: FloatArray) -> None:
        """Turn the panels toward world directions [E] [rad]."""

    def begin(self, displacement: FloatArray, room_m: FloatArray, watched: NDArray[np.bool_]) -> IntArray:
        """Begin a slot that leads by `displacement` [E, 2] [m]; the cells that must `drive` through it by ticks.

        `room_m` [E] [m] is how far a hull may go before its bumper can feel furniture. The others, unless `watched`
        [E], are at the end of their ways at once.
        """
        self.nearest_m[:], self.penetrations[:] = np.inf, 0
        return self._begin(displacement, room_m, watched)

    @abstractmethod
    def _begin(self, displacement: FloatArray, room_m: FloatArray, watched: NDArray[np.bool_]) -> IntArray:
        """`begin`, by the drive."""

    @abstractmethod
    def drive(self, cells: IntArray, room_m: FloatArray) -> None:
        """One tick of some cells' ways; `room_m` [n] [m] as in `begin`, and for people as well."""

    def read(self, cells: IntArray) -> tuple[FloatArray, FloatArray]:
        """The bumpers of some cells: distance [n, C] [m], inf where there is nothing, and horizontal direction to it.

        Keeps the smallest distance and the penetrations of the slot.
        """
        stale = cells[~self._sensed[cells]]
        if len(stale):
            self._batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS, ids=stale)
            self._sensed[stale] = True
        reading = self._bumper[cells]
        distance = np.where(reading[..., 0] > 0, reading[..., 1], np.inf)
        self.nearest_m[cells] = np.minimum(self.nearest_m[cells], distance.min(-1))
        self.penetrations[cells] += (distance < 0).sum(-1)
        return distance, reading[..., 2:4]

    def forget(self, cells: IntArray) -> None:
        """Something that the bumpers of some cells may feel has moved."""
        self._sensed[cells] = False

    def _free_travel(self, unit: FloatArray, cells: IntArray) -> FloatArray:
        """How far rovers may move along `unit` [n, 2] before they are within bumper_m of a contact, [n] [m].

        A contact's normal is that of a plane which separates the hull from a convex obstacle, so that a shorter
        move along `unit` cannot touch it.
        """
        distance, normal = self.read(cells)
        closing = normal[..., 0] * unit[:, None, 0] + normal[..., 1] * unit[:, None, 1]
        room = np.maximum(distance - self._config.bumper_m, 0)
        return np.where(closing > 1e-9, room / np.maximum(closing, 1e-9), np.inf).min(-1)

    def _heading(self, cells: IntArray | slice) -> FloatArray:
        w, x, y, z = self._pose[cells, 3:7].T
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def _turn_to(self, cells: IntArray, heading: FloatArray) -> None:
        quat = np.zeros((len(heading), 4))
        quat[:, 0], quat[:, 3] = np.cos(heading / 2), np.sin(heading / 2)
        self._pose[cells, 3:7] = quat


class StraightDrive(Fleet):
    """Poses moved along the straight line, at the speed and with the bumper of the wheels."""

    def __init__(self, config: World, office: Office, batch: Batch):
        super().__init__(config, office, batch)
        self._end = np.zeros((batch.nsim, 2))
        self._unit = np.zeros((batch.nsim, 2))
        self._left = np.zeros(batch.nsim)

    def face(self, direction: FloatArray) -> None:
        """At once."""
        self._pan[:] = _wrapped(direction - self.heading)

    def _begin(self, displacement: FloatArray, room_m: FloatArray, watched: NDArray[np.bool_]) -> IntArray:
        self._end = self._pose[:, :2] + displacement
        self._left = np.hypot(displacement[:, 0], displacement[:, 1])
        self._unit = displacement / np.maximum(self._left, 1e-12)[:, None]
        self._turn()
        by_ticks = np.logical_or(watched, self._left > room_m)
        at_once = np.flatnonzero(~by_ticks & (self._left > 0))
        self._pose[at_once, :2] = self._end[at_once]
        self.forget(at_once)
        return np.flatnonzero(by_ticks)

    def drive(self, cells: IntArray, room_m: FloatArray) -> None:
        """Straight ahead, as far as the bumper allows; it is read where it may feel something."""
        unit = self._unit[cells]
        # A hair more than the speed allows, so that rounding leaves nothing over after the last tick.
        step = np.minimum(self._left[cells], self._config.max_speed_mps * self._tick_s * (1 + 1e-9))
        wary = np.flatnonzero(step > room_m)
        if len(wary):
            step[wary] = np.minimum(step[wary], self._free_travel(unit[wary], cells[wary]))
        self._left[cells] -= step
        # From the end, not from the last place: ticks lead to the same number as one leap.
        self._pose[cells, :2] = self._end[cells] - self._left[cells, None] * unit
        self.forget(cells[step > 0])

    def _turn(self) -> None:
        """Face the way ahead; the panel keeps its direction if it has a motor."""
        moving = np.flatnonzero(self._left > _ARRIVED_M)
        before = self._heading(moving)
        ahead = np.arctan2(self._unit[moving, 1], self._unit[moving, 0])
        self._turn_to(moving, ahead)
        if self._config.pan != "locked":
            self._pan[moving] = _wrapped(self._pan[moving] + before - ahead)


class WheelDrive(Fleet):
    """Motors, friction and MuJoCo's dynamics."""

    def __init__(self, config: World, office: Office, batch: Batch):
        super().__init__(config, office, batch)
        self._substeps = max(1, round(self._tick_s / office.model.opt.timestep))
        self._wheels = [office.model.actuator(f"rover/wheel_{side}").id for side in ("left", "right")]
        self._pan_motor = office.model.actuator("rover/panel/pan").id
        self._target = np.zeros((batch.nsim, 2))

    def face(self, direction: FloatArray) -> None:
        """By the pan motor, which takes its time."""
        pan = _wrapped(direction - self.heading)
        # The nearest equivalent angle: the motor never takes the long way round.
        self._ctrl[:, self._pan_motor] = self._pan + _wrapped(pan - self._pan)

    def _begin(self, displacement: FloatArray, room_m: FloatArray, watched: NDArray[np.bool_]) -> IntArray:  # noqa: ARG002
        self._target = self._pose[:, :2] + displacement
        # Motors and friction want every step, whatever is near.
        return np.arange(len(room_m))

    def drive(self, cells: IntArray, room_m: FloatArray) -> None:  # noqa: ARG002
        """Wheel speeds toward the target for the physics steps of a tick; every step reads the bumper."""
        move = self._target[cells] - self._pose[cells, :2]
        length = np.hypot(move[:, 0], move[:, 1])
        heading = self._heading(cells)
        error = _wrapped(np.arctan2(move[:, 1], move[:, 0]) - heading)
        # A target behind is reached in reverse gear rather than by a U-turn.
        reverse = np.abs(error) > math.pi / 2
        error = np.where(reverse, _wrapped(error - math.pi), error)
        far = length > _ARRIVED_M
        speed = np.where(far, np.minimum(_APPROACH_PER_S * length, self._config.max_speed_mps), 0) * np.cos(error) ** 4
        turn = np.where(far, np.clip(_TURN_PER_S * error, -_MAX_TURN_RADPS, _MAX_TURN_RADPS), 0)
        gear = np.where(reverse, -1.0, 1.0)
        ahead = np.stack([np.cos(heading), np.sin(heading)], -1) * gear[:, None]
        speed = gear * np.minimum(speed * _SPEED_SHARE, self._free_travel(ahead, cells) / self._tick_s)
        left, right = speed - _HALF_TRACK_M * turn, speed + _HALF_TRACK_M * turn
        self._ctrl[cells[:, None], self._wheels] = np.stack([left, right], -1) / _WHEEL_RADIUS_M
        self._batch.step(cells, nstep=self._substeps, stage=mujoco.mjtStage.mjSTAGE_POS)
        self._sensed[cells] = True


def make_fleet(config: World, office: Office, batch: Batch) -> Fleet:
    """The rovers with the drive of `config`."""
    drive = StraightDrive if config.drive == "kinematic" else WheelDrive
    return drive(config, office, batch)


def _wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
