"""Policies on the same held-out scenes: sum rate and constraints, with 95 % intervals."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.constraints import NAMES
from mjris.radiomap import penalised
from mjris.task import Task

FloatArray = NDArray[np.floating]

Act = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""Actions [E, A] for observations [E, D]."""

_RESAMPLES = 4000

VARIANTS: Mapping[str, Mapping[str, str]] = {
    "learned": {"ris": "mobile", "phases": "learned"},
    "fixed RIS": {"ris": "fixed", "phases": "learned"},
    "random phases": {"ris": "mobile", "phases": "random"},
    "no RIS": {"ris": "none", "phases": "learned"},
}
"""What each compared policy changes in the task; the agent is the same in all of them."""


@dataclass(frozen=True)
class Played:
    """One policy on S scenes."""

    sum_rate_bps: FloatArray
    """Mean over the slots of every scene [S] [bit/s]."""
    value_bps: FloatArray
    """The same with the QoS penalty of eq. (R) [S] [bit/s]."""
    qos_share: FloatArray
    """Share of slots in which every user meets QoS [S]."""
    collisions: int
    clearance_m: float
    """Smallest clearance of all scenes [m]."""
    violations: Mapping[str, int]
    """Slots of all scenes that broke each constraint, by its name."""


def play(config: Config, act: Act, scenes: int, seed: int) -> Played:
    """One episode in each of `scenes` cells, all stepped together."""
    task = Task(config, num_cells=scenes)
    observation = task.reset(seed)
    rates, values, met = [], [], []
    collisions, clearance = 0, np.inf
    violations = dict.fromkeys(NAMES, 0)
    for _ in range(config.task.slots):
        outcome = task.step(np.asarray(act(observation), np.float64))
        observation, slot = outcome.observation, outcome.slot
        rates.append(slot.rates_bps.sum(-1))
        values.append(penalised(slot.rates_bps, config.task.qos_bps, config.task.qos_penalty))
        met.append(slot.qos_met.all(-1))
        collisions += int(slot.collisions.sum())
        clearance = min(clearance, float(slot.clearance_m.min()))
        for name in NAMES:
            violations[name] += int((~getattr(slot.constraints, name)).sum())
    return Played(np.mean(rates, 0), np.mean(values, 0), np.mean(met, 0), collisions, clearance, violations)


def compare(config: Config, act: Act, scenes: int, seed: int, report: Callable[[str], None]) -> pd.DataFrame:
    """Every variant of `VARIANTS` on the same scenes, one row each; `report` hears each variant's name first.

    Scenes are paired: furniture, people's steps and fading do not depend on what the agent does. The interval of
    the gain over no RIS is that of the paired differences. Raises `ConfigError` for fewer than two scenes.
    """
    if scenes < 2:
        raise ConfigError(f"scenes: {scenes} is not allowed: an interval needs at least 2")
    played = {}
    for name, changes in VARIANTS.items():
        report(name)
        played[name] = play(replace(config, task=replace(config.task, **changes)), act, scenes, seed)
    bare = played["no RIS"].sum_rate_bps
    rng = np.random.default_rng(seed)
    return pd.DataFrame([_row(name, result, bare, rng) for name, result in played.items()])


def _row(name: str, result: Played, bare: FloatArray, rng: np.random.Generator) -> dict[str, float | int | str]:
    rate = result.sum_rate_bps
    # Resampling whole scenes keeps the pairing, and asks for no particular distribution of the rates.
    resampled = rng.integers(len(rate), size=(_RESAMPLES, len(rate)))
    low, high = np.percentile(rate[resampled].mean(1), [2.5, 97.5]) / 1e6
    gain = rate[resampled].mean(1) / bare[resampled].mean(1) - 1
    gain_low, gain_high = 100 * np.percentile(gain, [2.5, 97.5])
    return {
        "policy": name,
        "scenes": len(rate),
        "sum_rate_mbps": rate.mean() / 1e6,
        "sum_rate_low": low,
        "sum_rate_high": high,
        "gain_percent": 100 * (rate.mean() / bare.mean() - 1),
        "gain_low": gain_low,
        "gain_high": gain_high,
        "penalised_mbps": result.value_bps.mean() / 1e6,
        "qos_share": result.qos_share.mean(),
        "collisions": result.collisions,
        "clearance_m": result.clearance_m,
        **{f"violated_{name}": count for name, count in result.violations.items()},
    }
