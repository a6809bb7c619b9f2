"""Training that diverges: it ends in one sentence, before what is no number reaches an environment or an average."""

from collections.abc import Mapping

import numpy as np
from stable_baselines3 import DDPG
from stable_baselines3.common.callbacks import BaseCallback
from torch import Tensor

from mjris.config import Config, ConfigError

_LOSSES = ("train/actor_loss", "train/critic_loss")


class Diverged(ConfigError):
    """The losses or parameters of an agent are no finite numbers; the message is one sentence for the user."""


def diverged(config: Config, cell: int, episode: int) -> Diverged:
    """What is raised for the agent of a cell, in an episode counted from 1."""
    return Diverged(
        f"agent.learning_rate: {config.agent.learning_rate:g} is not allowed: the agent of cell {cell} (seed "
        f"{config.seed}) diverged in episode {episode}, its losses or parameters are not finite any more: lower it"
    )


def non_finite(state: Mapping[str, Tensor]) -> str | None:
    """The first entry that holds NaN or an infinite number, if any."""
    # A sum takes less than half of the time, and is not finite where a number is not.
    suspects = ((name, tensor) for name, tensor in state.items() if not tensor.sum().isfinite())
    return next((name for name, tensor in suspects if not tensor.isfinite().all()), None)


class DivergenceCheck(BaseCallback):
    """Raises `Diverged` where losses or parameters are not finite: before each slot's action and when training ends."""

    def __init__(self, config: Config, cell: int, first_episode: int):
        super().__init__()
        self._config = config
        self._cell = cell
        self._episode = first_episode
        """That of the last slot."""
        self._over = False

    def _on_rollout_start(self) -> None:
        # SB3 begins a rollout for every slot; all that acting takes is the actor.
        assert isinstance(self.model, DDPG)
        self._check(self.model.actor.state_dict())

    def _on_step(self) -> bool:
        self._episode += self._over
        self._over = bool(self.locals["dones"][0])
        return True

    def _on_training_end(self) -> None:
        self._check(self.model.policy.state_dict())

    def _check(self, state: Mapping[str, Tensor]) -> None:
        logged = self.logger.name_to_value
        losses = [logged[name] for name in _LOSSES if name in logged]
        if not np.isfinite(losses).all() or non_finite(state) is not None:
            raise diverged(self._config, self._cell, self._episode)
