"""Drives the rovers of all cells: wheel commands toward the commanded place, and the bumper that stops them."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import World
from mjris.world.office import Office

FloatArray = NDArray[np.floating]

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


class Fleet:
    """The rovers of E cells on one batch; both drives read the same bumper."""

    def __init__(self, config: World, office: Office, batch: Batch):
        self._config = config
        self._batch = batch
        self._tick_s = config.slot_s / config.ticks_per_slot
        self._substeps = max(1, round(self._tick_s / office.model.opt.timestep))
        start = office.rover_qpos
        self._qpos = batch.bind("qpos")
        self._qvel = batch.bind("qvel")
        self._pose = self._qpos[:, start : start + 7]
        self._pan = self._qpos[:, office.pan_qpos]
        self._ctrl = batch.bind("ctrl")
        self._bumper = batch.bind("sensordata")[:, office.bumper].reshape(batch.nsim, -1, 5)
        self._rest = office.model.qpos0.copy()
        self._wheels = [office.model.actuator(f"rover/wheel_{side}").id for side in ("left", "right")]
        self._pan_motor = office.model.actuator("rover/panel/pan").id

    @property
    def xy(self) -> FloatArray:
        """Positions [E, 2] [m]."""
        return self._pose[:, :2].copy()

    @property
    def heading(self) -> FloatArray:
        """Directions of the rovers' fronts [E] [rad]."""
        w, x, y, z = self._pose[:, 3:7].T
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    @property
    def panel_heading(self) -> FloatArray:
        """Directions that the panels face [E] [rad]."""
        return self.heading + self._pan

    def place(self, cells: NDArray[np.int64], xy: FloatArray, heading: FloatArray) -> None:
        """Stand the rovers of some cells at rest: `xy` [n, 2] [m], `heading` [n] [rad], panels straight ahead."""
        self._qpos[cells] = self._rest
        self._qvel[cells] = 0
        self._ctrl[cells] = 0
        self._pose[cells, :2] = xy
        self._turn_to(cells, heading)

    def face(self, direction: FloatArray) -> None:
        """Turn the panels toward world directions [E] [rad]; the wheels drive's pan motor takes its time."""
        pan = _wrapped(direction - self.heading)
        if self._config.drive == "kinematic":
            self._pan[:] = pan
        else:
            # The nearest equivalent angle: the motor never takes the long way round.
            self._ctrl[:, self._pan_motor] = self._pan + _wrapped(pan - self._pan)

    def sense(self) -> None:
        """Refresh the bumper after positions were written."""
        self._batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS)

    def contacts(self) -> tuple[FloatArray, FloatArray]:
        """Bumper readings: distance [E, C] [m], inf where there is none, and horizontal direction to it [E, C, 2]."""
        found = self._bumper[..., 0] > 0
        return np.where(found, self._bumper[..., 1], np.inf), self._bumper[..., 2:4]

    def drive(self, target: FloatArray) -> None:
        """One tick toward `target` [E, 2] [m]; the bumper is current before and after."""
        if self._config.drive == "kinematic":
            self._drive_straight(target)
        else:
            self._drive_wheels(target)

    def _drive_straight(self, target: FloatArray) -> None:
        move = target - self._pose[:, :2]
        length = np.sqrt(np.einsum("ei,ei->e", move, move))
        step = np.minimum(length, self._config.max_speed_mps * self._tick_s)
        unit = move / np.maximum(length, 1e-12)[:, None]
        step = np.minimum(step, self._free_travel(unit))
        self._pose[:, :2] += step[:, None] * unit
        moving = np.flatnonzero(length > _ARRIVED_M)
        panel = self.panel_heading
        self._turn_to(moving, np.arctan2(unit[moving, 1], unit[moving, 0]))
        if self._config.pan == "auto":
            self._pan[:] = _wrapped(panel - self.heading)
        self.sense()

    def _drive_wheels(self, target: FloatArray) -> None:
        move = target - self._pose[:, :2]
        length = np.sqrt(np.einsum("ei,ei->e", move, move))
        heading = self.heading
        error = _wrapped(np.arctan2(move[:, 1], move[:, 0]) - heading)
        # A target behind is reached in reverse gear rather than by a U-turn.
        reverse = np.abs(error) > math.pi / 2
        error = np.where(reverse, _wrapped(error - math.pi), error)
        far = length > _ARRIVED_M
        speed = np.where(far, np.minimum(_APPROACH_PER_S * length, self._config.max_speed_mps), 0) * np.cos(error) ** 4
        turn = np.where(far, np.clip(_TURN_PER_S * error, -_MAX_TURN_RADPS, _MAX_TURN_RADPS), 0)
        gear = np.where(reverse, -1.0, 1.0)
        ahead = np.stack([np.cos(heading), np.sin(heading)], -1) * gear[:, None]
        speed = gear * np.minimum(speed * _SPEED_SHARE, self._free_travel(ahead) / self._tick_s)
        left, right = speed - _HALF_TRACK_M * turn, speed + _HALF_TRACK_M * turn
        self._ctrl[:, self._wheels] = np.stack([left, right], -1) / _WHEEL_RADIUS_M
        self._batch.step(nstep=self._substeps, stage=mujoco.mjtStage.mjSTAGE_POS)

    def _free_travel(self, unit: FloatArray) -> FloatArray:
        """How far the rovers may move along `unit` [E, 2] before they are within bumper_m of a contact, [E] [m].

        A contact's normal is that of a plane which separates the hull from a convex obstacle, so that a shorter
        move along `unit` cannot touch it.
        """
        distance, normal = self.contacts()
        closing = np.einsum("eci,ei->ec", normal, unit)
        room = np.maximum(distance - self._config.bumper_m, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            travel = np.where((closing > 1e-9) & np.isfinite(distance), room / closing, np.inf)
        return travel.min(-1)

    def _turn_to(self, cells: NDArray[np.int64], heading: FloatArray) -> None:
        quat = np.zeros((len(heading), 4))
        quat[:, 0], quat[:, 3] = np.cos(heading / 2), np.sin(heading / 2)
        self._pose[cells, 3:7] = quat


def _wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
