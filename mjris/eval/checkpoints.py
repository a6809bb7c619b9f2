"""Agents as they were during their training, on the held-out scenes that their rivals are judged on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, load
from mjris.eval.playing import play
from mjris.eval.policies import Act, agent_policies

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]

_MOST = 8
"""Checkpoints of a run that are judged."""


@dataclass(frozen=True)
class Judged:
    """The agents of R runs after C of their episodes, on the same S scenes."""

    episodes: IntArray
    """[C]"""
    sum_rate_bps: FloatArray
    """Means over the slots of every scene [C, R, S] [bit/s]."""
    bare_bps: FloatArray
    """The same slots without RIS, see `Played`, [C, R, S] [bit/s]."""


def judge(
    config: Config,
    runs: Sequence[Path],
    act: Callable[[Path, int], Act],
    scenes: int,
    seed: int,
    report: Callable[[str], None],
) -> Judged:
    """Play what `act` gives for a run folder and a round, for up to 8 rounds of all runs; `report` hears of each.

    Scenes are those of `compare` with the same `config`, `scenes` and `seed`.
    """
    rounds = spread(common_rounds(runs))
    rates, bare = np.empty((2, len(rounds), len(runs), scenes))
    for c, round_ in enumerate(rounds):
        for r, run in enumerate(runs):
            report(f"{run.name} after round {round_}")
            played = play(config, agent_policies(act(run, round_))[0], scenes, seed)
            rates[c, r], bare[c, r] = played.sum_rate_bps, played.bare_bps
    federation = load(runs[0] / "config.json").federation
    episodes = np.minimum(np.multiply(rounds, federation.round_episodes), federation.episodes)
    return Judged(episodes, rates, bare)


def common_rounds(runs: Sequence[Path]) -> list[int]:
    """The rounds that all runs have checkpoints of, in order."""
    kept = [
        {int(folder.name.removeprefix("round_")) for folder in (run / "checkpoints").glob("round_*")} for run in runs
    ]
    return sorted(set.intersection(*kept))


def spread(rounds: Sequence[int], most: int = _MOST) -> list[int]:
    """At most so many of the rounds, evenly spread, with the first and the last."""
    places = np.linspace(0, len(rounds) - 1, min(most, len(rounds)))
    return [rounds[place] for place in np.rint(places).astype(int)]
