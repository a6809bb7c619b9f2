"""Configs with names."""

from mjris.config.errors import ConfigError
from mjris.config.schema import Agent, Config, Federation, Radio, Task, World

_PAPER = Config(radio=Radio(element_pattern="isotropic"))

_OFFICE = Config(
    world=World(drive="kinematic"),
    task=Task(
        end="time_limit",
        motion="goal",
        phase_control="weights",
        power_reference="qos",
        observation="map",
        reward="gain",
    ),
    agent=Agent(network="mlp", batch_size=128, discount=0.9, target_rate=0.005, noise_scale=0.3, caution=1.0),
    federation=Federation(episodes=100, round_episodes=10),
)

_DEMO = Config(
    world=_OFFICE.world,
    task=_OFFICE.task,
    agent=_OFFICE.agent,
    federation=Federation(episodes=30, round_episodes=5),
)

_PRESETS = {"office": _OFFICE, "paper": _PAPER, "demo": _DEMO}


def preset(name: str) -> Config:
    """A named config: "office" (recommended), "paper" (the paper's literal agent) or "demo" (minutes).

    Raises `ConfigError` for any other name.
    """
    if name not in _PRESETS:
        raise ConfigError(f"preset: {name!r} is not known: it is one of {', '.join(_PRESETS)}")
    return _PRESETS[name]
