"""What the agents of E cells observe, decide and are rewarded for: array in, array out, over the simulator."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.config import Config
from mjris.radio.channel import Channels
from mjris.radiomap import bare_values, best_goals, penalised, place_values
from mjris.simulator import Controls, Simulator, Slot
from mjris.streams import CellId

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

_MAP_RADII_M = (0.6, 2.0, 5.0)
_MAP_DIRECTIONS = 8
_GOAL_REACH_M = 4.0
"""How far an action may move the goal of the radio map."""
_FAR_M = 12.0
"""The furthest waypoint, and what counts as one in observations: about half the diagonal of the default office."""
_USUAL_LOSS_DB, _LOSS_SPREAD_DB = 70, 15
"""What path losses are scaled by: indoors at some GHz they lie within 40 and 100 dB."""


@dataclass(frozen=True)
class Outcome:
    """One slot seen by the agents."""

    observation: NDArray[np.float32]
    """[E, D]"""
    reward: FloatArray
    """[E] [Mb/s]"""
    slot: Slot


class Task:
    """The agents' side of a simulator with E cells; see `Simulator` for which.

    An action in [-1, 1] is motion (2), phases (N, or K weights), powers (K) and perhaps pan (1); see `decode`.
    """

    def __init__(self, config: Config, cells: int | Sequence[CellId] = 1):
        self.config = config
        self.simulator = Simulator(config, cells)
        users = config.world.num_users
        self._num_phases = config.radio.num_elements if config.task.phase_control == "elements" else users
        self._pans = config.world.pan == "action"
        self.action_size = 2 + self._num_phases + users + self._pans
        room = [self.simulator.world.office(e).layout.room.size[:2] for e in range(self.simulator.num_cells)]
        self._half_room = np.array(room) / 2
        self._reach_m = config.world.max_speed_mps * config.world.slot_s
        angles = np.arange(_MAP_DIRECTIONS) * 2 * np.pi / _MAP_DIRECTIONS
        circle = np.stack([np.cos(angles), np.sin(angles)], -1)
        self._map_offsets = np.concatenate([radius * circle for radius in _MAP_RADII_M])
        self._lidar_ends = _MAP_RADII_M[-1] * circle
        self._planned_at: tuple[int, int] | None = None
        self._planned: tuple[FloatArray, FloatArray]
        self._valued_at: tuple[int, int] | None = None
        self._valued: FloatArray
        self.observation_size = self.observe().shape[1]

    def reset(self, seed: int | Sequence[int] | None = None) -> NDArray[np.float32]:
        """Begin an episode in every cell, with new random streams where seeds are given: observations [E, D]."""
        if seed is not None:
            self.simulator.seed(seed)
        self.simulator.reset()
        return self.observe()

    def step(self, action: FloatArray) -> Outcome:
        """Play one slot with actions [E, A]."""
        before = self._potential()
        slot = self.simulator.step(*self.decode(action))
        shaping = self.config.agent.discount * self._potential() - before
        return Outcome(self.observe(), self.reward(slot) + shaping, slot)

    def _potential(self) -> FloatArray | float:
        """Potential of the scene [E] [Mb/s], or zero, for rewards shaped as in Ng, Harada and Russell (1999)."""
        weight = self.config.task.map_potential
        if weight == 0:
            return 0.0
        simulator = self.simulator
        now = simulator.resets, simulator.slots
        if now != self._valued_at:
            here = place_values(simulator, simulator.scene.rover_xy[:, None])[:, 0]
            self._valued_at, self._valued = now, weight * (here - bare_values(simulator)) / 1e6
        return self._valued

    def decode(self, action: FloatArray) -> Controls:
        """What actions [E, A] command.

        Motion is a point of the disc that the rover can reach in a slot; or a way toward the radio map's goal, moved
        by up to 4 m, with fine control of small moves. Phases are π times the action; or the closed-form alignment for
        user weights of 10 to the power of it. Powers are shares of what a user may have, (1 + a)/2; or the closed-form
        ones for least rates of 1 + `qos_headroom` (1 + a)/2 times the QoS. Neither exceeds the budget.
        Pan is π times the action, from the bisector of AP and users.
        """
        action = np.clip(np.asarray(action, np.float64), -1, 1)
        phases_end = 2 + self._num_phases
        phases_rad = self._phases(action[:, 2:phases_end])
        powers = action[:, phases_end : phases_end + self.config.world.num_users]
        pan_rad = np.pi * action[:, -1] if self._pans else None
        return Controls(self._displacement(action[:, :2]), phases_rad, self._powers(powers, phases_rad), pan_rad)

    def observe(self) -> NDArray[np.float32]:
        """Observations of the present scene [E, D], every entry of order one."""
        if self.config.task.observation == "map":
            parts = self._observe_map()
            return np.concatenate([part.reshape(self.simulator.num_cells, -1) for part in parts], 1).astype(np.float32)
        scene = self.simulator.scene
        observation = np.empty((self.simulator.num_cells, self._csi_size()), np.float32)
        _observe_csi(
            observation,
            scene.rover_xy,
            scene.panel_heading,
            scene.users_xy,
            self._half_room,
            scene.path_loss_db,
            scene.channels,
        )
        return observation

    def reward(self, slot: Slot) -> FloatArray:
        """Rewards [E] [Mb/s]: eq. (R), minus the same slot's value without RIS if the reward is "gain"."""
        task = self.config.task
        value = penalised(slot.rates_bps, task.qos_bps, task.qos_penalty)
        if slot.bare_rates_bps is not None:
            value = value - penalised(slot.bare_rates_bps, task.qos_bps, task.qos_penalty)
        return value / 1e6

    def _displacement(self, move: FloatArray) -> FloatArray:
        if self.config.task.ris != "mobile":
            return np.zeros_like(move)
        length = np.sqrt(np.vecdot(move, move))[:, None]
        inside = move / np.maximum(length, 1)
        if self.config.task.motion == "displacement":
            return self._reach_m * inside
        # The square gives fine control nearby.
        offset = np.minimum(length, 1) * inside
        if self.config.task.motion == "waypoint":
            return self.simulator.world.way_toward(self.simulator.scene.rover_xy + _FAR_M * offset)
        return self.simulator.world.way_toward(self._goals()[0] + _GOAL_REACH_M * offset)

    def _phases(self, action: FloatArray) -> FloatArray:
        if self.config.task.phases == "random":
            return self.simulator.random_phases()
        if self.config.task.phase_control == "weights":
            return self.simulator.reference_phases(10.0**action)
        return np.pi * action

    def _powers(self, action: FloatArray, phases_rad: FloatArray) -> FloatArray:
        task = self.config.task
        shares = (1 + action) / 2
        if task.power_reference == "qos":
            effective = self.simulator.effective_channel(phases_rad)
            powers, _ = self.simulator.reference_powers(effective, task.qos_bps * (1 + task.qos_headroom * shares))
            return powers
        return self.simulator.split_powers(shares)

    def _csi_size(self) -> int:
        k, m, n = self.config.world.num_users, self.config.radio.num_antennas, self.config.radio.num_elements
        return 4 + 2 * k + 2 * k + 1 + 2 * (k * m + n * m + k * n)

    def _observe_map(self) -> list[FloatArray]:
        """Positions, gains of the users' channels and the radio map around the rover.

        What places around it are worth more than its own, how far the ways there are free, and where the map's goal
        is and what it promises.
        """
        scene, world = self.simulator.scene, self.simulator.world
        here = scene.rover_xy[:, None]
        values = place_values(self.simulator, np.concatenate([here, here + self._map_offsets], 1)) / 1e6
        gain = values[:, 1:] - values[:, :1]
        ends = here + self._lidar_ends
        keep = world.hull_radius_m + self.config.world.bumper_m
        lidar = np.minimum(world.free_share(np.broadcast_to(here, ends.shape), ends, keep), 1)
        goal, promised = self._goals()
        return [
            *self._positions(),
            (scene.users_xy - here) / self._half_room[:, None],
            _scaled_loss(scene.path_loss_db),
            *self._user_gains(),
            values[:, :1],
            5 * gain,
            lidar,
            _compressed(goal - scene.rover_xy),
            5 * (promised[:, None] / 1e6 - values[:, :1]),
        ]

    def _user_gains(self) -> list[FloatArray]:
        """Gains of the users' direct channels, and of all elements in phase [E, K] each, scaled like path losses."""
        direct, incident, reflected = self.simulator.scene.channels
        strength = np.linalg.norm(direct, axis=-1)
        panel = (np.abs(reflected) * np.linalg.norm(incident, axis=-1)[:, None]).sum(-1)
        return [_scaled_loss(-20 * np.log10(np.maximum(amplitude, 1e-9))) for amplitude in (strength, panel)]

    def _goals(self) -> tuple[FloatArray, FloatArray]:
        """`best_goals` of the present slot: what is observed is also what the action corrects."""
        simulator = self.simulator
        now = simulator.resets, simulator.slots
        if now != self._planned_at:
            self._planned_at, self._planned = now, best_goals(simulator)
        return self._planned

    def _positions(self) -> list[FloatArray]:
        scene = self.simulator.scene
        heading = scene.panel_heading[:, None]
        rover = scene.rover_xy / self._half_room - 1
        users = scene.users_xy / self._half_room[:, None] - 1
        return [rover, np.cos(heading), np.sin(heading), users]


@compiled
def _observe_csi(
    seen: NDArray[np.float32],
    rover_xy: FloatArray,
    panel_heading: FloatArray,
    users_xy: FloatArray,
    half_room: FloatArray,
    loss_db: FloatArray,
    channels: Channels,
) -> None:
    """The paper's state, eq. (S), [E, D]: positions, path losses, and fading with the path loss taken out."""
    users, elements = users_xy.shape[1], channels.incident.shape[1]
    for e in range(len(seen)):
        x, y = half_room[e]
        seen[e, 0], seen[e, 1] = rover_xy[e, 0] / x - 1, rover_xy[e, 1] / y - 1
        seen[e, 2], seen[e, 3] = math.cos(panel_heading[e]), math.sin(panel_heading[e])
        for k in range(users):
            seen[e, 4 + 2 * k], seen[e, 5 + 2 * k] = users_xy[e, k, 0] / x - 1, users_xy[e, k, 1] / y - 1
        at = 4 + 2 * users
        for link in range(2 * users + 1):
            seen[e, at + link] = (loss_db[e, link] - _USUAL_LOSS_DB) / _LOSS_SPREAD_DB
        at += 2 * users + 1
        for k in range(users):
            at = _write_fading(seen[e], at, users, channels.direct[e, k], loss_db[e, k])
        at += users * channels.direct.shape[2]
        for n in range(elements):
            at = _write_fading(seen[e], at, elements, channels.incident[e, n], loss_db[e, 2 * users])
        at += elements * channels.incident.shape[2]
        for k in range(users):
            at = _write_fading(seen[e], at, users, channels.reflected[e, k], loss_db[e, users + k])


@compiled
def _write_fading(seen: NDArray[np.float32], at: int, rows: int, row: ComplexArray, loss_db: float) -> int:
    """Write a link's row of real parts from `at` on, and the imaginary ones as many `rows` behind; where it ends."""
    amplitude, columns = 10.0 ** (loss_db / 20), len(row)
    for column in range(columns):
        seen[at + column] = row[column].real * amplitude
        seen[at + column + rows * columns] = row[column].imag * amplitude
    return at + columns


def _compressed(offset_m: FloatArray) -> FloatArray:
    """Offsets [..., 2] [m] of order one, their lengths under a square root: what is near matters in detail."""
    length = np.linalg.norm(offset_m, axis=-1, keepdims=True)
    return offset_m / np.sqrt(_FAR_M * np.maximum(length, 1e-9))


def _scaled_loss(loss_db: FloatArray) -> FloatArray:
    """Path losses [dB] around zero and of order one."""
    return (loss_db - _USUAL_LOSS_DB) / _LOSS_SPREAD_DB
