"""Records one episode of one cell: what pictures and video are made of."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjris.simulation.task import Task

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]
Act = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""From observations [E, D] to actions [E, A]."""


@dataclass(frozen=True)
class Rollout:
    """T slots of an episode, with F = T · ticks a slot poses, N elements of all panels, K users and L links."""

    qpos: FloatArray
    """Positions of all joints after every tick [F, nq]."""
    mocap_pos: FloatArray
    """Places of the people after every tick [F, K, 3] [m]."""
    mocap_quat: FloatArray
    """Orientations of the people after every tick [F, K, 4]."""
    phases_rad: FloatArray
    """[T, N] [rad]"""
    rates_bps: FloatArray
    """[T, K] [bit/s]"""
    qos_met: NDArray[np.bool_]
    """[T, K]"""
    blockers: IntArray
    """Obstacles on the links as each slot began, in the order of `Links` [T, L]."""
    rover_xy: FloatArray
    """Where the rover stood as each slot began, and at the end [T + 1, 2] [m]."""
    users_xy: FloatArray
    """Where the users stood as each slot began, and at the end [T + 1, K, 2] [m]."""
    reward: FloatArray
    """[T] [Mb/s]"""
    clearance_m: FloatArray
    """Smallest distance between the hull and anything in each slot [T] [m]."""
    collisions: IntArray
    """Penetrating contacts in each slot [T]."""

    @property
    def slots(self) -> int:
        """T"""
        return len(self.reward)

    @property
    def frames(self) -> int:
        """F"""
        return len(self.qpos)

    @property
    def sum_rate_bps(self) -> FloatArray:
        """[T] [bit/s]"""
        return self.rates_bps.sum(1)

    def slot_of(self, frame: int) -> int:
        """The slot that a frame [0, F) lies in."""
        return frame * self.slots // self.frames


def record(task: Task, act: Act, slots: int, seed: int) -> Rollout:
    """Play `slots` slots of a task with one cell, from a reset with `seed`."""
    simulator = task.simulator
    world = simulator.world
    live = {name: world.batch.bind(name) for name in ("qpos", "mocap_pos", "mocap_quat")}
    track: dict[str, list[NDArray[Any]]] = {name: [] for name in live}

    def keep(**values: NDArray[Any]) -> None:
        for name, value in values.items():
            track.setdefault(name, []).append(np.array(value[0]))

    observation = task.reset(seed)
    world.on_tick = lambda: keep(**live)
    try:
        for _ in range(slots):
            scene = simulator.scene
            controls = task.decode(np.asarray(act(observation), np.float64))
            slot = simulator.step(*controls)
            keep(
                phases_rad=controls.phases_rad,
                rates_bps=slot.rates_bps,
                qos_met=slot.qos_met,
                blockers=scene.blockers,
                rover_xy=scene.rover_xy,
                users_xy=scene.users_xy,
                reward=task.reward(slot),
                clearance_m=slot.clearance_m,
                collisions=slot.collisions,
            )
            observation = task.observe()
    finally:
        world.on_tick = None
    keep(rover_xy=simulator.scene.rover_xy, users_xy=simulator.scene.users_xy)
    return Rollout(**{name: np.stack(values) for name, values in track.items()})
