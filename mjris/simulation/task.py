"""What the agents of E cells observe, decide and are rewarded for: array in, array out, over the simulator."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.planning.radio_map import penalised
from mjris.radio.links import Channels
from mjris.simulation import observation
from mjris.simulation.checks import checked
from mjris.simulation.outlook import bare_values, best_goals, place_values
from mjris.simulation.scene import Controls, Scene, Slot
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId
from mjris.simulation.units import rate_unit_bps

FloatArray = NDArray[np.floating]

_GOAL_REACH_M = 4.0
"""How far an action may move the goal of the radio map."""


@dataclass(frozen=True)
class Outcome:
    """One slot seen by the agents."""

    observation: NDArray[np.float32]
    """[E, D]"""
    reward: FloatArray
    """[E], in `Task.rate_unit_bps`"""
    slot: Slot


class Task:
    """The agents' side of a simulator with E cells; see `Simulator` for which.

    An action in [-1, 1] is motion (2), phases (N, or K weights), powers (K) and perhaps pan (1); see `decode`.
    """

    def __init__(self, config: Config, cells: int | Sequence[CellId] = 1):
        self.config = config
        self.simulator = Simulator(config, cells)
        users = config.world.num_users
        self._num_phases = self.simulator.num_elements if config.task.phase_control == "elements" else users
        self._pans = config.world.pan == "action"
        self.action_size = 2 + self._num_phases + users + self._pans
        self.rate_unit_bps = rate_unit_bps(config)
        """Unit of rewards [bit/s]: 1 Mb/s with the paper's numbers."""
        self._reach_m = config.world.max_speed_mps * config.world.slot_s
        self._planned_for: Scene | None = None
        self._planned: tuple[FloatArray, FloatArray]
        self._valued_for: Scene | None = None
        self._valued: FloatArray
        self.observation_size = self.observe().shape[1]

    def reset(self, seed: int | Sequence[int] | None = None) -> NDArray[np.float32]:
        """Begin an episode in every cell, with new random streams where seeds are given: observations [E, D]."""
        if seed is not None:
            self.simulator.seed(seed)
        self.simulator.reset()
        return self.observe()

    def step(self, action: FloatArray) -> Outcome:
        """Play one slot with actions [E, A]. Raises `ValueError` for any other shape and for numbers not finite."""
        before = self._potential()
        slot = self.simulator.step(*self.decode(action))
        shaping = self.config.agent.discount * self._potential() - before
        return Outcome(self.observe(), self.reward(slot) + shaping, slot)

    def _potential(self) -> FloatArray | float:
        """Potential of the scene [E] in the unit of rewards, or zero: shaping as in Ng, Harada and Russell (1999)."""
        task, simulator = self.config.task, self.simulator
        weight = task.map_potential
        if weight == 0:
            return 0.0
        if self._valued_for is not simulator.scene:
            here = place_values(simulator, simulator.scene.rover_xy[:, None])[:, 0]
            gain_bps = here - bare_values(simulator)
            self._valued_for, self._valued = simulator.scene, weight * gain_bps / self.rate_unit_bps
        if task.end == "time_limit":
            return self._valued
        # After a true end nothing is to be had: shaping has to add up to the potential of the start.
        return np.where(simulator.slots < task.slots, self._valued, 0.0)

    def decode(self, action: FloatArray) -> Controls:
        """What actions [E, A] command.

        Motion is a point of the disc that the rover can reach in a slot; or a way toward the radio map's goal, moved
        by up to 4 m, with fine control of small moves. Phases are π times the action; or the closed-form alignment for
        user weights of 10 to the power of it. Powers are shares of what a user may have, (1 + a)/2; or the closed-form
        ones for least rates of 1 + `qos_headroom` (1 + a)/2 times the QoS. Neither exceeds the budget.
        Pan is π times the action, from the bisector of AP and users. Raises `ValueError` for any other shape and for
        numbers not finite.
        """
        action = np.clip(checked("action", action, (self.simulator.num_cells, self.action_size)), -1, 1)
        phases_end = 2 + self._num_phases
        phases, powers = action[:, 2:phases_end], action[:, phases_end : phases_end + self.config.world.num_users]
        pan_rad = np.pi * action[:, -1] if self._pans else None

        def retune(channels: Channels) -> tuple[FloatArray, FloatArray]:
            phases_rad = self._phases(phases, channels)
            return phases_rad, self._powers(powers, phases_rad, channels)

        phases_rad, powers_w = retune(self.simulator.scene.known)
        return Controls(self._displacement(action[:, :2]), phases_rad, powers_w, pan_rad, retune)

    def observe(self) -> NDArray[np.float32]:
        """Observations of the present scene [E, D], every entry of order one.

        Where episodes truly end, the last one is the share of the slots that are left.
        """
        task, simulator = self.config.task, self.simulator
        if task.observation == "map":
            seen = observation.radio_map(simulator, *self._goals())
        else:
            seen = observation.channel_state(simulator)
        if task.end == "time_limit":
            return seen
        left = 1 - simulator.slots[:, None] / task.slots
        return np.concatenate([seen, left], 1, dtype=np.float32)

    def reward(self, slot: Slot) -> FloatArray:
        """Rewards [E] in `rate_unit_bps`: eq. (R), minus the same slot's value without RIS if the reward is "gain"."""
        task = self.config.task
        value = penalised(slot.rates_bps, task.qos_bps, task.qos_penalty)
        if task.reward == "gain":
            value = value - penalised(slot.bare_rates_bps, task.qos_bps, task.qos_penalty)
        return value / self.rate_unit_bps

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
            return self.simulator.terrain.way_toward(self.simulator.scene.rover_xy + observation.FAR_M * offset)
        return self.simulator.terrain.way_toward(self._goals()[0] + _GOAL_REACH_M * offset)

    def _phases(self, action: FloatArray, channels: Channels) -> FloatArray:
        if self.config.task.phases == "random":
            return self.simulator.random_phases()
        if self.config.task.phase_control == "weights":
            return self.simulator.reference_phases(10.0**action, channels)
        return np.pi * action

    def _powers(self, action: FloatArray, phases_rad: FloatArray, channels: Channels) -> FloatArray:
        task, simulator = self.config.task, self.simulator
        shares = (1 + action) / 2
        if task.power_reference == "qos":
            effective = simulator.effective_channel(phases_rad, channels)
            wanted_bps = task.qos_bps * (1 + task.qos_headroom * shares)
            powers, _ = simulator.reference_powers(effective, wanted_bps, simulator.order)
            return powers
        return self.simulator.split_powers(shares)

    def _goals(self) -> tuple[FloatArray, FloatArray]:
        """`best_goals` of the present slot: what is observed is also what the action corrects."""
        simulator = self.simulator
        if self._planned_for is not simulator.scene:
            self._planned_for, self._planned = simulator.scene, best_goals(simulator)
        return self._planned
