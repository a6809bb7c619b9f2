"""The paper's DDPG agent in Stable-Baselines3: batch-normalised networks and decaying exploration noise."""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.td3.policies import Actor, TD3Policy
from torch import nn

from mjris.config import Config
from mjris.world.panels import all_elements

_OU_THETA = 0.15  # rate of mean reversion a slot, the value of the DDPG paper (Lillicrap et al., 2015)


class PaperCritic(ContinuousCritic):
    """SB3's critic with batch normalisation before every linear layer, but none when it judges the actor's actions.

    The mean over a batch of anything behind batch normalisation is constant, and so would be the actor's objective,
    the mean of Q: its gradient would be exactly zero. The actor is therefore judged with the running statistics.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        # SB3 keeps the network twice: as a submodule, and in the plain list that its forward pass reads.
        self.qf0 = self.q_networks[0] = _batch_normalised(self.q_networks[0])

    def q1_forward(self, obs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Value [B, 1] of the actor's own actions [B, A], with the running statistics."""
        training = self.training
        self.set_training_mode(False)
        values = super().q1_forward(obs, actions)
        self.set_training_mode(training)
        return values


class CautiousCritic(ContinuousCritic):
    """SB3's critic, which charges the actor for the size of its actions.

    The actor maximises Q / |Q| - c a², both means over the batch: behaviour cloning toward action zero as in TD3+BC
    (Fujimoto and Gu, 2021). With c = 0 it is SB3's own.
    """

    def __init__(self, *args: Any, caution: float, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.caution = caution

    def q1_forward(self, obs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Value [B, 1] of the actor's own actions [B, A], less what they cost."""
        values = super().q1_forward(obs, actions)
        if self.caution == 0:
            return values
        cost = self.caution * actions.square().mean(-1, keepdim=True)
        return values / values.detach().abs().mean() - cost


class CautiousPolicy(TD3Policy):
    """SB3's actor and critic, with the caution of `CautiousCritic`."""

    def __init__(self, *args: Any, caution: float, **kwargs: Any):
        self._caution = caution
        super().__init__(*args, **kwargs)

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> CautiousCritic:
        """The critic, observation [B, D] and action [B, A] → one value [B, 1]."""
        kwargs = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return CautiousCritic(caution=self._caution, **kwargs)


class PaperPolicy(TD3Policy):
    """SB3's actor and critic with batch normalisation before every linear layer (paper, section V-C).

    The actor is batch norm, 4MN ReLU, batch norm, tanh; the critic has the same form without the tanh. SB3 puts the
    networks in training mode for updates only, so single observations are acted on with the running statistics.
    """

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """The actor, observation [B, D] → action [B, A]."""
        actor = super().make_actor(features_extractor)
        actor.mu = _batch_normalised(actor.mu)
        return actor

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> PaperCritic:
        """The critic, observation [B, D] and action [B, A] → one value [B, 1]."""
        return PaperCritic(**self._update_features_extractor(self.critic_kwargs, features_extractor))


def _batch_normalised(network: nn.Module) -> nn.Sequential:
    """The layers of a sequential network with batch normalisation before every linear layer."""
    layers: list[nn.Module] = []
    for layer in network.children():
        if isinstance(layer, nn.Linear):
            layers.append(nn.BatchNorm1d(layer.in_features))
        layers.append(layer)
    return nn.Sequential(*layers)


class DecayingOUNoise(ActionNoise):
    """Ornstein-Uhlenbeck noise whose standard deviation falls linearly from ξ_0 to zero (eq. (Action)).

    An episode starts from the stationary distribution, so the noise of slot t of the run is N(0, ξ_t²) in every slot,
    and neighbouring slots of an episode have correlation e^(-θ). The decay counts the slots of the whole run: it goes
    on over episodes and over separate calls of `learn`.
    """

    def __init__(self, size: int, scale: float, total_slots: int, rng: np.random.Generator):
        super().__init__()
        self._size = size
        self._scale = scale
        self._total_slots = total_slots
        self._rng = rng
        self._slot = 0
        self._state: np.ndarray | None = None

    @property
    def scale(self) -> float:
        """ξ_t, the standard deviation of the next sample."""
        return float(self._scales(1)[0])

    def reset(self) -> None:
        """Forget the episode; the next sample is independent of those before."""
        # Nothing is drawn here: SB3 resets twice where an episode's end is a chunk's end, and both must count once.
        self._state = None

    def __call__(self) -> np.ndarray:
        """The noise of the next slot, float32 [A]."""
        return self.ahead(1)[0]

    def ahead(self, slots: int) -> np.ndarray:
        """That of the next slots, float32 [T, A]: what as many calls would give."""
        noise = self._rng.standard_normal((slots, self._size))
        memory = np.exp(-_OU_THETA)
        fresh = np.sqrt(1.0 - memory**2)
        scales = self._scales(slots)
        for slot in range(slots):
            if self._state is not None:
                noise[slot] = memory * self._state + fresh * noise[slot]
            self._state = noise[slot]
        self._slot += slots
        return (scales[:, None] * noise).astype(np.float32)

    def _scales(self, slots: int) -> np.ndarray:
        """ξ_t of the next slots [T]."""
        return self._scale * np.maximum(0.0, 1.0 - (self._slot + np.arange(slots)) / self._total_slots)


def build_agent(config: Config, env: gym.Env, rng: np.random.Generator, first_weights: int | None = None) -> DDPG:
    """An untrained agent for `env`, on the CPU and with an empty logger.

    The exploration noise follows from `rng`, which the agent keeps, and so do the first weights, but where they have
    a seed of their own, `first_weights`. SB3 draws the weights, minibatches and warm-up actions from the global random
    generators and seeds them here.
    """
    assert isinstance(env.action_space, gym.spaces.Box)
    own_weights = weights_seed(rng)  # drawn in any case, so that the noise does not depend on whose weights are taken
    agent = config.agent
    model = DDPG(
        PaperPolicy if agent.network == "paper" else CautiousPolicy,
        env,
        learning_rate=agent.learning_rate,
        buffer_size=agent.buffer_size,
        learning_starts=agent.warmup_slots,
        batch_size=agent.batch_size,
        tau=agent.target_rate,
        gamma=agent.discount,
        action_noise=DecayingOUNoise(
            env.action_space.shape[0], agent.noise_scale, config.federation.episodes * config.task.slots, rng
        ),
        policy_kwargs={
            "net_arch": hidden_layers(config),
            "n_critics": 1,
            "optimizer_kwargs": {"fused": True},  # one call instead of a dozen for every small tensor
            **({} if agent.network == "paper" else {"caution": agent.caution}),
        },
        seed=own_weights if first_weights is None else first_weights,
        device="cpu",
    )
    # Without a logger of its own, SB3 makes a temporary folder at every call of `learn`.
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def weights_seed(rng: np.random.Generator) -> int:
    """The seed of an agent's first weights: the first that is drawn from its generator."""
    return int(rng.integers(2**32))


def hidden_layers(config: Config) -> dict[str, Any]:
    """Widths of the hidden layers of actor (pi) and critic (qf)."""
    agent = config.agent
    if agent.network == "mlp":
        return {"pi": list(agent.hidden), "qf": list(agent.hidden)}
    # The paper gives 4MN for the actor and "a minor size" for the critic; half of it is our choice.
    width = 4 * config.radio.num_antennas * all_elements(config)
    return {"pi": [width], "qf": [width // 2]}
