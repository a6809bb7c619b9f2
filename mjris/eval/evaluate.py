"""Policies on the same held-out scenes: sum rate and constraints, with 95 % intervals."""

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.eval import parking
from mjris.eval.intervals import gain_percent, interval
from mjris.eval.playing import Played, play
from mjris.eval.policies import Act, agent_policies, fixed_ris, no_ris, planner, reference_controls, reference_oma
from mjris.simulation.constraints import NAMES
from mjris.simulation.streams import Purpose, generator

FloatArray = NDArray[np.floating]

_COUNTS = ("collisions", *(f"violated_{name}" for name in NAMES))
_BOUND = "upper bound"


def compare(
    config: Config, act: Act, scenes: int, seed: int, report: Callable[[str], None], *, with_planner: bool = True
) -> pd.DataFrame:
    """The agent, its variants and its rivals on the same scenes, a row each; `report` hears each one's name first.

    Scenes are independent of each other (`radio.difference_factor` is taken as 1), and the same for every policy:
    furniture, where people start, how they mean to step, and fading. They are not the same to the last step, for people
    wait while a rover is in their way. The gain over no RIS is therefore judged within the slots that a policy played:
    its sum rate against that of the best powers known for the very same direct channels, resampled together by scenes.
    The best-placed fixed RIS has found its spot (`x_m`, `y_m`, `heading_deg`) in other scenes, see `parking`.

    With the planner there are shares of its sum rate, and of the upper bound's: the mean of what no phases and powers
    could exceed for the channels along the planner's drive. It does not bound who drives elsewhere. Raises
    `ConfigError` for fewer than two scenes and a negative seed.
    """
    if scenes < 2:
        raise ConfigError(f"scenes: {scenes} is not allowed: an interval needs at least 2")
    if seed < 0:
        raise ConfigError(f"scene_seed: {seed} is not allowed: it must be at least 0")
    report("places for a fixed RIS")
    spot = parking.best_spot(config, seed)
    oma = reference_oma() if config.radio.scheme == "noma" else []
    parked = [fixed_ris(), parking.parked_at(spot)]
    rng = generator(seed, Purpose.RESAMPLING)
    rows = []
    for policy in [*agent_policies(act), reference_controls(), *parked, *oma, no_ris()]:
        report(policy.name)
        rows.append(_row(policy.name, play(config, policy, scenes, seed), rng))
    if with_planner:
        report("planner")
        planned = play(config, planner(seed), scenes, seed, bounded=True)
        rows.append(_row("planner", planned, rng))
        rows.append(_rate_columns(_BOUND, planned.bound_bps, planned.bare_bps, rng))
    table = pd.DataFrame(rows).astype(dict.fromkeys(_COUNTS, "Int64"))
    for name, value in spot._asdict().items():
        table.loc[table["policy"] == parking.NAME, name] = value
    if with_planner:
        for column, row in (("percent_of_planner", -2), ("percent_of_bound", -1)):
            table[column] = 100 * table["sum_rate_mbps"] / table["sum_rate_mbps"].iloc[row]
    return table


def _row(name: str, result: Played, rng: np.random.Generator) -> dict[str, float | int | str]:
    return {
        **_rate_columns(name, result.sum_rate_bps, result.bare_bps, rng),
        "penalised_mbps": result.value_bps.mean() / 1e6,
        "qos_share": result.qos_share.mean(),
        "user_qos_share": result.user_qos_share.mean(),
        "user_rate_p5_mbps": result.user_rate_p5_bps.mean() / 1e6,
        "jain": result.jain.mean(),
        "superposing_share": result.superposing_share.mean(),
        "mbit_per_joule": result.sum_rate_bps.mean() / (result.radiated_w.mean() + result.panels_w) / 1e6,
        "collisions": result.collisions,
        "clearance_m": result.clearance_m,
        **{f"violated_{constraint}": count for constraint, count in result.violations.items()},
    }


def _rate_columns(
    name: str, rate: FloatArray, bare: FloatArray, rng: np.random.Generator
) -> dict[str, float | int | str]:
    low, high = interval(lambda mean: mean, rate / 1e6, rng=rng)
    gain_low, gain_high = interval(gain_percent, rate, bare, rng=rng)
    return {
        "policy": name,
        "scenes": len(rate),
        "sum_rate_mbps": rate.mean() / 1e6,
        "sum_rate_low": low,
        "sum_rate_high": high,
        "gain_percent": float(gain_percent(rate.mean(), bare.mean())),
        "gain_low": gain_low,
        "gain_high": gain_high,
    }
