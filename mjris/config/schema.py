"""Every parameter of a run, with its unit in its name and its default: frozen dataclasses."""

import math
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass

from mjris.config.errors import ConfigError, plain_errors
from mjris.config.fields import STRICT, Count, NonNegative, Positive
from mjris.config.radio import Radio

_CAUTION = 0.85
"""Share of what the wheels can brake at that is counted on: 15 % are for leaning masts and long physics steps."""
_SERVO_M = 0.01
"""What the servo takes to let go of the last speed."""


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class World:
    """The office, the rover and the people."""

    layout: str = "office"
    """Name of a layout in assets/layouts, or the path of a layout file (.toml)."""
    layout_jitter_m: NonNegative = 0.0
    """Each cell's furniture stands up to this far from the layout's places [m]."""
    drive: Literal["wheels", "kinematic"] = "wheels"
    """wheels: motors and friction; kinematic: straight lines at the same speed and with the same bumper."""
    start_m: tuple[float, float] | None = None
    """Where the rover starts, x and y [m]; the layout's place by default."""
    start_heading_deg: float | None = None
    """Where it faces then, counter-clockwise from +x [°]; anywhere by default."""
    num_users: Count = 4
    """K, people who carry a receiver."""
    slot_s: Annotated[float, Field(ge=0.01, le=60)] = 1.0
    """Length of a time slot [s]."""
    ticks_per_slot: Annotated[int, Field(ge=1, le=1000)] = 10
    """How often in a slot the controller reads the bumper, drives and lets people walk."""
    timestep_s: Annotated[float, Field(ge=1e-4, le=0.02)] = 0.02
    """Longest physics time step of the wheels drive [s]."""
    max_speed_mps: Annotated[float, Field(ge=0.01, le=2)] = 0.5
    """v_max of the rover [m/s]; a fast one needs a bumper that feels far, see `braking_mps2`."""
    bumper_m: Annotated[float, Field(ge=0.02, le=0.5)] = 0.1
    """The bumper feels obstacles from this distance on [m]."""
    clearance_m: Annotated[float, Field(ge=0.02, le=1)] = 0.15
    """People keep this distance from furniture, walls, the rover and each other [m]."""
    walk_scale_m: Annotated[float, Field(ge=0, le=10)] = 0.3
    """Scale of the Rayleigh distance that a person walks in a slot [m]; its mean is 1.25 times that."""
    user_height_m: Annotated[float, Field(gt=0, le=2)] = 1.1
    """Height of the users' receivers [m]: where a person can hold one, below every ceiling."""
    panel_height_m: Annotated[float, Field(ge=0.6, le=2.2)] = 1.5
    """Height of the panel's centre [m]."""
    pan: Literal["auto", "action", "locked"] = "auto"
    """auto: the mast turns the panel to the bisector of AP and users; action: one more action turns it from there;
    locked: it faces the rover's front."""
    body_blockage: bool = False
    """Whether people's bodies block links (never the link to their own receiver)."""
    rover_blockage: bool = False
    """Whether the rover's panel and mast block links (never those over its panel)."""

    @property
    def braking_mps2(self) -> float:
        """What the wheels can brake at [m/s²]: as much as the treads hold of what is left on them.

        Treads with friction 1 hold as much as weighs on them, and braking shifts weight to the caster, l = 0.15 m
        ahead: a = g - a z/l. With the panel the centre of mass is at z, as the masses of rover.xml and ris.xml have it.
        """
        centre_m = (14 * 0.13 + 2 * 0.5 * 0.08 + 0.8 * self.panel_height_m) / 15.8
        return 9.81 / (1 + centre_m / 0.15)

    @model_validator(mode="after")
    def _can_stop(self) -> "World":
        tick_m = self.max_speed_mps * self.slot_s / self.ticks_per_slot
        needed = tick_m + self.max_speed_mps**2 / (2 * _CAUTION * self.braking_mps2) + _SERVO_M
        for name in ("bumper_m", "clearance_m"):
            if getattr(self, name) < needed:
                raise ValueError(
                    f"world.{name}: {getattr(self, name)} is not allowed: at world.max_speed_mps {self.max_speed_mps}, "
                    f"world.slot_s {self.slot_s}, world.ticks_per_slot {self.ticks_per_slot} and world.panel_height_m "
                    f"{self.panel_height_m} the rover needs {math.ceil(needed * 1e3) / 1e3} m to notice and stop"
                )
        return self


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Task:
    """What the agent sees, decides and is rewarded for."""

    slots: Count = 100
    """Slots of an episode."""
    end: Literal["terminal", "time_limit"] = "terminal"
    """What the last slot is: terminal: nothing comes after it, and the share of slots that are left is observed;
    time_limit: things would go on, so that what is observed at last has the value of what would follow."""
    phase_updates_per_slot: Annotated[int, Field(ge=0)] = 0
    """How often in a slot phases and powers are set anew, to be held in between while things move; the slot's rates are
    means over its ticks. 0: as often as it takes, so that a slot's rates are those at its start."""
    ris: Literal["mobile", "turning", "fixed", "none"] = "mobile"
    """mobile: the agent drives; turning: the rover stays where it starts, and its panel turns as world.pan says; fixed:
    the panel stays, too, and faces the bisector of AP and the room's middle, or the rover's front where pan is locked;
    none: no RIS at all."""
    phases: Literal["learned", "random"] = "learned"
    """learned: from the action; random: drawn anew whenever they are set."""
    motion: Literal["displacement", "waypoint", "goal"] = "displacement"
    """displacement: where to in this slot; waypoint: a place from the rover, driven to on the shortest free way; goal:
    the same, from the place that the radio map promises most for."""
    horizon_slots: Count = 12
    """How far ahead the radio map's goal is chosen; people are taken to stay where they are for so long."""
    phase_control: Literal["elements", "weights"] = "elements"
    """elements: a phase for each; weights: one for each user in the closed-form alignment to the observed channel."""
    ascent_steps: Annotated[int, Field(ge=0)] = 0
    """Steps of an ascent on the phases from the closed-form ones, for the sum rate with QoS; then what clusters spend
    is searched, too. 0: none, and every cluster spends P_max/V."""
    power_reference: Literal["even", "qos"] = "even"
    """even: shares of what a user may have; qos: the closed-form split, for least rates from the QoS on."""
    qos_headroom: NonNegative = 0.1
    """How far above the QoS an action can set a user's least rate, relative."""
    map_potential: NonNegative = 0.0
    """Weight of what the radio map says that the RIS gains where the rover is, as a potential in the reward; with
    1/(1 - γ) the critic has only to learn how the map errs, and the best policy stays the same."""
    observation: Literal["csi", "map"] = "csi"
    """csi: the paper's state; map: geometry in the rover's frame and the gain map around it."""
    reward: Literal["sum_rate", "gain"] = "sum_rate"
    """sum_rate: the paper's; gain: minus what the same slot gives without RIS under a fixed power rule."""
    qos_bps: NonNegative = 10e3
    """R_QoS, the least rate of every user [bit/s]."""
    qos_penalty: Annotated[float, Field(ge=1)] = 2.0
    """λ: the reward is divided by this where any user misses QoS."""


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Agent:
    """DDPG and its networks."""

    network: Literal["paper", "mlp"] = "paper"
    """paper: batch norm, 4MN ReLU, batch norm, tanh; mlp: plain ReLU layers."""
    hidden: tuple[Count, ...] = (128, 128)
    """Hidden layers of the mlp network."""
    learning_rate: Positive = 3e-4
    """α of Adam."""
    batch_size: Annotated[int, Field(ge=2)] = 64
    """e, transitions in a minibatch."""
    discount: Annotated[float, Field(ge=0, le=1)] = 1.0
    """γ; the paper's 1 needs episodes that end, see task.end."""
    target_rate: Annotated[float, Field(gt=0, le=1)] = 0.002
    """τ, target update rate."""
    noise_scale: NonNegative = 0.4
    """ξ_0, scale of the Ornstein-Uhlenbeck action noise, which decays to zero over the run."""
    caution: NonNegative = 0.0
    """What the actor pays for full actions, relative to the size of its values: it stays near action zero, which may
    stand for a closed form, unless the critic is sure."""
    buffer_size: Count = 100_000
    """Transitions in the replay memory."""
    warmup_slots: Annotated[int, Field(ge=0)] = 200
    """Slots with random actions before the first update."""

    @model_validator(mode="after")
    def _only_plain_networks_are_cautious(self) -> "Agent":
        if self.caution > 0 and self.network == "paper":
            raise ValueError(
                f"agent.caution: {self.caution} is not allowed: it must be 0 where agent.network is 'paper', as only "
                "mlp networks have it"
            )
        return self


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Federation:
    """Cells and how their agents are merged."""

    num_cells: Count = 3
    """U, cells (floors), one agent each."""
    episodes: Count = 300
    """Episodes of every cell."""
    round_episodes: Count = 20
    """F_G, episodes between two averages."""
    averaging: bool = True
    """Whether agents are averaged at all; without it they learn alone."""
    first_weights: Literal["own", "common"] = "own"
    """own: every cell starts from random weights of its own, as in the paper; common: all from those of cell 0."""
    backend: Literal["auto", "stacked", "processes"] = "auto"
    """stacked: cells learn in lockstep, as many at once as a process has; processes: one by one; auto: the faster."""
    workers: Annotated[int, Field(ge=0)] = 0
    """Processes at most in which cells learn; 0 is one a core, 1 is this one."""


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Config:
    """Everything that determines a run."""

    world: World = World()
    radio: Radio = Radio()
    task: Task = Task()
    agent: Agent = Agent()
    federation: Federation = Federation()
    seed: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """All randomness follows from it; a run without one draws one and keeps it."""

    @model_validator(mode="after")
    def _consistent(self) -> "Config":
        if self.world.num_users % self.radio.num_clusters:
            raise ValueError(
                f"world.num_users: {self.world.num_users} is not allowed: "
                f"it must be a multiple of radio.num_clusters, which is {self.radio.num_clusters}"
            )
        if self.radio.num_clusters > self.radio.num_antennas:
            raise ValueError(
                f"radio.num_clusters: {self.radio.num_clusters} is not allowed: zero forcing needs an antenna "
                f"for each, and radio.num_antennas is {self.radio.num_antennas}"
            )
        if self.agent.discount == 1 and self.task.end == "time_limit":
            raise ValueError(
                "agent.discount: 1.0 is not allowed: with task.end time_limit the value of every last observation is "
                "added to that of the slots before, and at 1 this has no end; it must be less, or task.end terminal"
            )
        if self.radio.knowledge.age_s > self.world.slot_s:
            raise ValueError(
                f"radio.knowledge.age_s: {self.radio.knowledge.age_s} is not allowed: channels are estimated at least "
                f"once a slot, and world.slot_s is {self.world.slot_s}"
            )
        updates, ticks = self.task.phase_updates_per_slot, self.world.ticks_per_slot
        if updates and ticks % updates:
            raise ValueError(
                f"task.phase_updates_per_slot: {updates} is not allowed: "
                f"it must divide world.ticks_per_slot, which is {ticks}"
            )
        return self

    @property
    def named_seed(self) -> int:
        """The seed. Raises `ConfigError` where there is none."""
        if self.seed is None:
            raise ConfigError("seed: none is given, and what depends on chance cannot be kept without one")
        return self.seed

    def to_json(self) -> str:
        """The config as JSON text, ending in a newline."""
        return ADAPTER.dump_json(self, indent=2).decode() + "\n"

    def to_dict(self) -> dict[str, Any]:
        """The config as nested dicts of plain values."""
        return ADAPTER.dump_python(self)


ADAPTER = TypeAdapter(Config)
"""Configs from and to plain values."""
