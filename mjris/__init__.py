"""mjris: a reconfigurable intelligent surface on a robot in an office, and the agents that learn to drive it."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from mjris.envs.gym_env import OfficeEnv
    from mjris.envs.sb3_vec import OfficeVecEnv, make_vec

__all__ = ["OfficeEnv", "OfficeVecEnv", "make_vec"]

_HOMES = {"OfficeEnv": "gym_env", "OfficeVecEnv": "sb3_vec", "make_vec": "sb3_vec"}

gymnasium.register(id="mjris/Office-v0", entry_point="mjris.envs.gym_env:OfficeEnv")


def __getattr__(name: str) -> Any:
    """Import the environments, and with them MuJoCo and SB3, when they are first asked for."""
    if name in _HOMES:
        return getattr(import_module(f"mjris.envs.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'mjris' has no attribute {name!r}")
