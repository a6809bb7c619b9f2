"""What is put on trial: an agent and its variants, and rivals that need no learning."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.eval.optimum import search
from mjris.radio.links import Channels
from mjris.radio.powers import best_powers
from mjris.simulation.outlook import best_goals
from mjris.simulation.scene import Controls
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import Purpose, generator
from mjris.simulation.task import Task

FloatArray = NDArray[np.floating]

Act = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""Actions [E, A] for observations [E, D]."""


@dataclass(frozen=True)
class Policy:
    """What decides in every slot, and what it changes in the config that it plays."""

    name: str
    controls: Callable[[Task], Controls]
    """What to do in the present slot; called once a slot."""
    changes: Mapping[str, Mapping[str, Any]]
    """Fields of the config, by section."""

    def changed(self, config: Config) -> Config:
        """The config with the changes. Raises `ConfigError` where a value is not allowed."""
        sections = {name: replace(getattr(config, name), **fields) for name, fields in self.changes.items()}
        return replace(config, **sections)


def agent_policies(act: Act) -> list[Policy]:
    """The agent as it is, and with its driving, its phases or the whole RIS taken away."""

    def controls(task: Task) -> Controls:
        return task.decode(np.asarray(act(task.observe()), np.float64))

    return [
        Policy(name, controls, {"task": {"ris": ris, "phases": phases}})
        for name, ris, phases in (
            ("learned", "mobile", "learned"),
            ("fixed RIS", "fixed", "learned"),
            ("fixed RIS, panel turns", "turning", "learned"),
            ("random phases", "mobile", "random"),
            ("no RIS", "none", "learned"),
        )
    ]


def reference_controls() -> Policy:
    """Action zero: what the task's closed forms do by themselves, so that the rest is what learning adds."""
    return Policy("reference controls", _action_zero, {"task": {"ris": "mobile", "phases": "learned"}})


def reference_oma() -> list[Policy]:
    """The same with OMA: serving every user, and with a scheduler that may select them as NOMA's powers do."""
    reference = reference_controls()
    return [
        Policy(name, _action_zero, {**reference.changes, "radio": radio})
        for name, radio in (
            (f"{reference.name}, OMA", {"scheme": "oma"}),
            ("OMA, users selected", {"scheme": "oma", "oma_selection": True}),
        )
    ]


def fixed_ris(name: str = "closed forms, fixed RIS", world: Mapping[str, Any] = MappingProxyType({})) -> Policy:
    """A RIS that neither drives nor turns, with closed-form phases and powers whatever the task has for actions.

    It stands where `world` says, fields of the config, or where every episode starts.
    """
    closed = {"phases": "learned", "phase_control": "weights", "power_reference": "qos"}
    # Nobody observes or drives: what a map shows, and what wheels do, would be worked out in vain.
    task = {"ris": "fixed", "observation": "csi", **closed}
    return Policy(name, _action_zero, {"task": task, "world": {"drive": "kinematic", **world}})


def _action_zero(task: Task) -> Controls:
    return task.decode(np.zeros((task.simulator.num_cells, task.action_size)))


def believing_in_sight() -> Policy:
    """Closed forms that drive for a radio map without walls: as if everything were in line of sight."""

    def controls(task: Task) -> Controls:
        goal, _ = best_goals(task.simulator, walls=False)
        return _action_zero(task)._replace(displacement_m=task.simulator.terrain.way_toward(goal))

    return Policy("believes in line of sight", controls, reference_controls().changes)


def no_ris() -> Policy:
    """No RIS, and the best powers known for users who are decoded in the order that they are."""

    def controls(task: Task) -> Controls:
        simulator = task.simulator

        def tune(channels: Channels) -> tuple[FloatArray, FloatArray]:
            powers = best_powers(simulator.system, channels.direct, simulator.order)
            return np.zeros((simulator.num_cells, simulator.num_elements)), powers

        return Controls(parked(simulator), *tune(simulator.scene.known), retune=tune)

    return Policy("no RIS, best powers", controls, {"task": {"ris": "none"}})


def planner(seed: int) -> Policy:
    """The planner's drive, and the best phases and powers known in every slot; random starts follow from `seed`.

    They are the best for users who are decoded in the order that they are.
    """
    rng = generator(seed, Purpose.SEARCH)

    def controls(task: Task) -> Controls:
        simulator = task.simulator

        def tune(channels: Channels) -> tuple[FloatArray, FloatArray]:
            best = search(simulator.system, simulator.surface, channels, rng, simulator.order)
            return best.phases_rad, best.powers_w

        return Controls(planned(simulator), *tune(simulator.scene.known), retune=tune)

    return Policy("planner", controls, {"task": {"ris": "mobile"}})


def planned(simulator: Simulator) -> FloatArray:
    """Displacement [E, 2] [m] toward the place that promises most over the next slots, see `best_goals`."""
    goal, _ = best_goals(simulator)
    return simulator.terrain.way_toward(goal)


def parked(simulator: Simulator) -> FloatArray:
    """No displacement, [E, 2] [m]."""
    return np.zeros((simulator.num_cells, 2))
