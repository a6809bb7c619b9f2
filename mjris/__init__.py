"""mjris: a reconfigurable intelligent surface on a robot in an office, and the agents that learn to drive it."""

from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from mjris.env import OfficeEnv, OfficeVecEnv, make_vec

__all__ = ["OfficeEnv", "OfficeVecEnv", "make_vec"]

gymnasium.register(id="mjris/Office-v0", entry_point="mjris.env:OfficeEnv")


def __getattr__(name: str) -> Any:
    """Import the environments, and with them MuJoCo and SB3, when they are first asked for."""
    if name in __all__:
        from mjris import env

        return getattr(env, name)
    raise AttributeError(f"module 'mjris' has no attribute {name!r}")
