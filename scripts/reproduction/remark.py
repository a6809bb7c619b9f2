"""The paper's argument for federated exploration (its Remark and proof), by Monte Carlo."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reproduction.drawing import STYLE, WIDTH_IN

FloatArray = NDArray[np.floating]

_ACTIONS = 50
"""|A_N|, actions of a state, each with a reward of its own."""
_CELLS = 3
"""Agents of the federation."""
_TRIES = (1, 2, 4, 8, 16, 32, 64, 128)
"""Random tries, with repetition, of every agent."""
_SIMILAR_TRIES = 16
_SIMILARITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
_TRIALS = 20_000
_ALONE, _TOGETHER = ("#0072b2", "o"), ("#009e73", "P")


@dataclass(frozen=True)
class Explored:
    """What is found by agents that try actions at random, by the number of tries."""

    tries: int
    alone: float
    """Share of trials in which the one agent has found the best reward that is known."""
    together: float
    """The same for the federation, whose agents tell each other of what they find."""
    alone_paper: float
    """The paper's formula for the first."""
    together_paper: float
    """The paper's formula for the second."""
    alone_given: float
    """The first, given that somebody has found that reward."""
    together_given: float
    """The second, given the same."""


def explore(tries: int, rng: np.random.Generator, trials: int = _TRIALS) -> Explored:
    """Play the proof's set-up: one agent, and a federation of `_CELLS`, on a state with `_ACTIONS` actions.

    Actions are numbered by their rewards, so that the best of some actions is the largest number.
    The paper's formula is 1 - (1 - 1/r)^E|A|, with r actions no better than the best known one and E|A| different
    actions tried. It leaves out that somebody has found that one: with n and m tries the exact probability is
    (1 - (1 - 1/r)^n) / (1 - (1 - 1/r)^(n + m)).
    """
    alone = rng.integers(1, _ACTIONS + 1, (trials, tries))
    together = rng.integers(1, _ACTIONS + 1, (trials, _CELLS * tries))
    rank = np.maximum(alone.max(1), together.max(1))
    missed = 1 - 1 / rank
    somebody = 1 - missed ** ((1 + _CELLS) * tries)
    return Explored(
        tries=tries,
        alone=float((alone.max(1) == rank).mean()),
        together=float((together.max(1) == rank).mean()),
        alone_paper=float((1 - missed ** different(tries)).mean()),
        together_paper=float((1 - missed ** different(_CELLS * tries)).mean()),
        alone_given=float(((1 - missed**tries) / somebody).mean()),
        together_given=float(((1 - missed ** (_CELLS * tries)) / somebody).mean()),
    )


def different(tries: int) -> float:
    """E|A|, different actions among so many tries with repetition."""
    return _ACTIONS * (1 - (1 - 1 / _ACTIONS) ** tries)


def best_reward(similarity: float, rng: np.random.Generator, trials: int = _TRIALS) -> tuple[float, float]:
    """Mean reward in its own cell of the action that an agent knows as best: alone, and told by the others.

    Rewards are Gaussian, with correlation `similarity` between cells; an action's reward is what whoever tried it got.
    """
    common = rng.standard_normal((trials, 1, _ACTIONS))
    rewards = np.sqrt(similarity) * common
    rewards = rewards + np.sqrt(1 - similarity) * rng.standard_normal((trials, _CELLS, _ACTIONS))
    tried = rng.integers(0, _ACTIONS, (trials, _CELLS, _SIMILAR_TRIES))
    found = np.take_along_axis(rewards, tried, 2)
    own_best = tried[:, 0][np.arange(trials), found[:, 0].argmax(1)]
    all_best = tried.reshape(trials, -1)[np.arange(trials), found.reshape(trials, -1).argmax(1)]
    own = rewards[:, 0]
    return float(own[np.arange(trials), own_best].mean()), float(own[np.arange(trials), all_best].mean())


def measure(rng: np.random.Generator) -> tuple[pd.DataFrame, pd.DataFrame]:
    """What is found by tries, and the best rewards by similarity of the cells."""
    found = pd.DataFrame([explore(tries, rng) for tries in _TRIES])
    rewards = [(similarity, *best_reward(similarity, rng)) for similarity in _SIMILARITIES]
    return found, pd.DataFrame(rewards, columns=["similarity", "alone", "together"])


def draw_remark(found: pd.DataFrame, rewards: pd.DataFrame, path: Path) -> None:
    """Write both as a figure."""
    with rc_context(STYLE):
        sheet = Figure(figsize=(WIDTH_IN, 4.8), dpi=300, layout="constrained")
        above, below = sheet.subplots(2)
        for name, (colour, marker) in (("alone", _ALONE), ("together", _TOGETHER)):
            words = "one agent" if name == "alone" else f"federation of {_CELLS}"
            style = {"color": colour, "marker": marker, "ms": 4}
            above.plot(found["tries"], found[name], ls="", label=f"{words}, Monte Carlo", **style)
            above.plot(found["tries"], found[f"{name}_paper"], color=colour, ls="--", lw=1, label="paper's formula")
            above.plot(found["tries"], found[f"{name}_given"], color=colour, lw=1, label="given that it is known")
            below.plot(rewards["similarity"], rewards[name], lw=1, label=words, **style)
        above.set_xscale("log", base=2)
        above.set_xticks(_TRIES, [str(tries) for tries in _TRIES])
        above.set(xlabel=f"tries of each agent, of {_ACTIONS} actions", ylabel="has found the best known")
        above.set_ylim(0, 1.03)
        above.legend(fontsize=6, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.22))
        below.set(xlabel="correlation of rewards between cells", ylabel="reward of the best known action [σ]")
        below.legend(fontsize=6)
        sheet.savefig(path)
