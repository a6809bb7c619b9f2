"""How rovers move toward the commanded place: along the straight line, or by motors, wheels and friction."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import World
from mjris.jit.compiled import compiled
from mjris.world.footprints import Footprints, Rectangles, gap, toward
from mjris.world.office import PERSON_RADIUS_M, Office
from mjris.world.people import Crowd, Walkers, walk
from mjris.world.rover import Bumper, Fleet, free_travel, heading_of

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_WHEEL_RADIUS_M = 0.08
_HALF_TRACK_M = 0.17
_APPROACH_PER_S = 4.0
"""Speed per distance left, so that the rover slows down before its target [1/s]."""
_TURN_PER_S = 4.0
"""Turning rate per heading error [1/s]."""
_SWEPT = (0.0, 0.5, 1.0)
"""Shares of a tick's turn at which its direction must be free."""
_MAX_TURN_RADPS = 3.0
_ARRIVED_M = 0.01
_SPEED_SHARE = 0.97
"""Wheel commands stay this far below v_max, for the servo's ripple."""
_DOUBT = 1e-3
"""How far geometry is trusted not to differ from contacts, in their distances [m] and normals."""


class StraightDrive(Fleet):
    """Poses moved along the straight line, at the speed and with the bumper of the wheels."""

    def __init__(self, config: World, office: Office, batch: Batch, solid: Footprints, crowd: Crowd):
        super().__init__(config, office, batch, solid, crowd)
        cells = batch.nsim
        self._way = _Way(
            end=np.zeros((cells, 2)),
            unit=np.zeros((cells, 2)),
            left_m=np.zeros(cells),
            room_m=np.zeros(cells),
            tick=np.zeros(cells, np.int64),
            waits=np.zeros(cells, np.bool_),
            # A hair more than the speed allows, so that rounding leaves nothing over after the last tick.
            most_m=config.max_speed_mps * self._tick_s * (1 + 1e-9),
            hull_m=self.hull_radius_m,
            feeler_m=self._feeler_m,
        )

    def face(self, direction: FloatArray) -> None:
        """At once."""
        self._pan[:] = _wrapped(direction - self.heading)

    def _drive(self, displacement: FloatArray, on_tick: Callable[[], None] | None) -> None:
        way, ticks = self._way, self._config.ticks_per_slot
        _set_out(way, self._pose, self._pan, displacement, self._config.pan != "locked")
        for tick in [ticks] if on_tick is None else range(1, ticks + 1):
            # Cells go their ways until they have come to the tick or have to feel what is around.
            while _go_on(way, tick, self._pose, self._crowd.walkers, self._solid.arrays, self._bumper):
                self._feel(np.flatnonzero(way.waits))
            if on_tick is not None:
                on_tick()


class _Way(NamedTuple):
    """Straight ways of E rovers."""

    end: FloatArray
    """Where they lead [E, 2] [m]."""
    unit: FloatArray
    """Their directions [E, 2]."""
    left_m: FloatArray
    """What is left of them [E] [m]."""
    room_m: FloatArray
    """Furniture and walls are at least that far from the rover's middle [E] [m]."""
    tick: IntArray
    """Ticks that are behind each [E]."""
    waits: NDArray[np.bool_]
    """Who cannot end the present tick before the bumper is read [E]."""
    most_m: float
    """Furthest way of a tick [m]."""
    hull_m: float
    """Radius of the hull [m]."""
    feeler_m: float
    """What is that far from the hull cannot be felt [m]."""


@compiled
def _set_out(way: _Way, pose: FloatArray, pan: FloatArray, displacement: FloatArray, pans: bool) -> None:
    """Begin ways of `displacement` [E, 2] [m]: face ahead, while a panel with a motor keeps its direction."""
    for cell in range(len(pose)):
        u, v = displacement[cell]
        length = math.hypot(u, v)
        way.end[cell, 0], way.end[cell, 1] = pose[cell, 0] + u, pose[cell, 1] + v
        way.unit[cell, 0], way.unit[cell, 1] = u / max(length, 1e-12), v / max(length, 1e-12)
        way.left_m[cell], way.room_m[cell], way.tick[cell], way.waits[cell] = length, 0.0, 0, False
        if length > _ARRIVED_M:
            before, ahead = heading_of(pose[cell]), math.atan2(v, u)
            pose[cell, 3:7] = 0
            pose[cell, 3], pose[cell, 6] = math.cos(ahead / 2), math.sin(ahead / 2)
            if pans:
                pan[cell] = (pan[cell] + before - ahead + math.pi) % (2 * math.pi) - math.pi


@compiled
def _go_on(way: _Way, tick: int, pose: FloatArray, people: Walkers, solid: Rectangles, bumper: Bumper) -> bool:
    """Drive and walk until `tick` ticks are over, or the bumper has to be read; whether it has to anywhere."""
    anyone_waits, out_of_reach_m = False, way.hull_m + way.feeler_m
    for cell in range(len(pose)):
        office = cell % solid[0].shape[1]
        while way.tick[cell] < tick:
            step = min(way.left_m[cell], way.most_m)
            if not way.waits[cell]:
                x, y = pose[cell, 0], pose[cell, 1]
                person = walk(people, cell, x, y) - PERSON_RADIUS_M
                if person <= out_of_reach_m:
                    bumper.fresh[cell] = False
                if step > way.room_m[cell] - out_of_reach_m:
                    way.room_m[cell] = gap(solid, office, x, y)
                clearance = min(way.room_m[cell], person) - way.hull_m
                if clearance < way.feeler_m and not bumper.fresh[cell]:
                    bumper.nearest_m[cell] = min(bumper.nearest_m[cell], clearance)
                way.waits[cell] = clearance - way.feeler_m < step and (
                    bumper.fresh[cell] or _may_be_stopped(way, cell, step, x, y, people, solid, bumper.keep_m)
                )
            if way.waits[cell]:
                if not bumper.fresh[cell]:
                    anyone_waits = True
                    break
                step = min(step, free_travel(bumper, cell, way.unit[cell, 0], way.unit[cell, 1]))
                way.waits[cell] = False
            if step > 0:
                bumper.fresh[cell] = False
                way.left_m[cell] -= step
                way.room_m[cell] -= step
                # From the end, not from the last place: ticks lead to the same number as one leap.
                pose[cell, 0] = way.end[cell, 0] - way.left_m[cell] * way.unit[cell, 0]
                pose[cell, 1] = way.end[cell, 1] - way.left_m[cell] * way.unit[cell, 1]
            way.tick[cell] += 1
    return anyone_waits


@compiled
def _may_be_stopped(
    way: _Way, cell: int, step: float, x: float, y: float, people: Walkers, solid: Rectangles, keep_m: float
) -> bool:
    """Whether `free_travel` could be less than `step` [m] for a rover at a place, as outlines on the floor have it."""
    u, v, office = way.unit[cell, 0], way.unit[cell, 1], cell % solid[0].shape[1]
    for b in range(solid[0].shape[2]):
        away_x, away_y = toward(solid, office, b, x, y)
        if _may_stop(away_x, away_y, way.hull_m, u, v, step, keep_m):
            return True
    for k in range(people.xy.shape[1]):
        away_x, away_y = people.xy[cell, k, 0] - x, people.xy[cell, k, 1] - y
        if _may_stop(away_x, away_y, way.hull_m + PERSON_RADIUS_M, u, v, step, keep_m):
            return True
    return False


@compiled
def _may_stop(away_x: float, away_y: float, radii_m: float, u: float, v: float, step: float, keep_m: float) -> bool:
    """`_may_be_stopped` by one thing that is (away_x, away_y) off, less the radii of what is round."""
    away = math.sqrt(away_x * away_x + away_y * away_y)
    distance, closing = away - radii_m, away_x * u + away_y * v
    if distance - keep_m > step + _DOUBT:
        return False
    closing /= max(away, 1e-12)
    return distance <= 0 or (closing > -_DOUBT and distance - keep_m < closing * step + _DOUBT)


class WheelDrive(Fleet):
    """Motors, friction and MuJoCo's dynamics."""

    def __init__(self, config: World, office: Office, batch: Batch, solid: Footprints, crowd: Crowd):
        super().__init__(config, office, batch, solid, crowd)
        self._substeps = max(1, round(self._tick_s / office.model.opt.timestep))
        self._wheels = [office.model.actuator(f"rover/wheel_{side}").id for side in ("left", "right")]
        self._pan_motor = office.model.actuator("rover/panel/pan").id
        self._cells = np.arange(batch.nsim)

    def face(self, direction: FloatArray) -> None:
        """By the pan motor, which takes its time."""
        pan = _wrapped(direction - self.heading)
        # The nearest equivalent angle: the motor never takes the long way round.
        self._ctrl[:, self._pan_motor] = self._pan + _wrapped(pan - self._pan)

    def _drive(self, displacement: FloatArray, on_tick: Callable[[], None] | None) -> None:
        target = self._pose[:, :2] + displacement
        max_speed_mps, out_of_reach_m = self._config.max_speed_mps, self.hull_radius_m + self._feeler_m
        for _ in range(self._config.ticks_per_slot):
            nearest = self._crowd.walk(self.xy)
            self._bumper.fresh[nearest - PERSON_RADIUS_M <= out_of_reach_m] = False
            self._feel(self._cells)
            self._ctrl[:, self._wheels] = _wheel_speeds(self._pose, target, self._bumper, max_speed_mps, self._tick_s)
            self._batch.step(nstep=self._substeps, stage=mujoco.mjtStage.mjSTAGE_POS)
            self._bumper.fresh[:] = True
            if on_tick is not None:
                on_tick()


@compiled
def _wheel_speeds(
    pose: FloatArray, target: FloatArray, bumper: Bumper, max_speed_mps: float, tick_s: float
) -> FloatArray:
    """Angular speeds [E, 2] [rad/s] of the left and the right wheel toward `target` [E, 2] [m] for a tick."""
    speeds = np.empty((len(pose), 2))
    # A long tick must not lead beyond its target.
    approach_per_s, turn_per_s = min(_APPROACH_PER_S, 1 / tick_s), min(_TURN_PER_S, 1 / tick_s)
    for cell in range(len(pose)):
        x, y = target[cell, 0] - pose[cell, 0], target[cell, 1] - pose[cell, 1]
        length, heading, gear = math.hypot(x, y), heading_of(pose[cell]), 1.0
        error = (math.atan2(y, x) - heading + math.pi) % (2 * math.pi) - math.pi
        # A target behind is reached in reverse gear rather than by a U-turn.
        if abs(error) > math.pi / 2:
            gear = -1.0
            error = error % (2 * math.pi) - math.pi
        speed, turn = 0.0, 0.0
        if length > _ARRIVED_M:
            speed = min(approach_per_s * length, max_speed_mps) * math.cos(error) ** 4
            turn = min(max(turn_per_s * error, -_MAX_TURN_RADPS), _MAX_TURN_RADPS)
        travel = np.inf
        for share in _SWEPT:
            ahead = heading + share * turn * tick_s
            travel = min(travel, free_travel(bumper, cell, gear * math.cos(ahead), gear * math.sin(ahead)))
        speed = gear * min(speed * _SPEED_SHARE, travel / tick_s)
        speeds[cell, 0] = (speed - _HALF_TRACK_M * turn) / _WHEEL_RADIUS_M
        speeds[cell, 1] = (speed + _HALF_TRACK_M * turn) / _WHEEL_RADIUS_M
    return speeds


def make_fleet(config: World, office: Office, batch: Batch, solid: Footprints, crowd: Crowd) -> Fleet:
    """The rovers with the drive of `config`."""
    drive = StraightDrive if config.drive == "kinematic" else WheelDrive
    return drive(config, office, batch, solid, crowd)


def _wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
