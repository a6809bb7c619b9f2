"""Whether two states of the code give the same numbers: rates of many configs, with the same seeds and actions.

python scripts/same_numbers.py record FILE.npz     on either side
python scripts/same_numbers.py compare A.npz B.npz [--tolerance 1e-9]

Recorded are every rate of three cells under random actions (observations too), and what closed forms, the powers known
best without RIS, the planner and the bound give. `compare` names the largest relative difference of each kind, and ends
with status 1 where one exceeds the tolerance. The planner is a search, which rounding may lead elsewhere: it has a
tolerance of its own.
"""

import os
import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is loaded
from mjris import make_vec
from mjris.config import Config, preset
from mjris.eval.playing import play
from mjris.eval.policies import no_ris, planner, reference_controls, reference_oma

CELLS, SLOTS, SCENES, PLAYED_SLOTS = 3, 25, 2, 10
SEARCHED = "planner"
Sections = dict[str, dict[str, Any]]

_QUIET = {"noise_dbm_per_mhz": -100.0}
CASES: dict[str, tuple[str, Sections]] = {
    "paper": ("paper", {}),
    "paper, kinematic, quiet": ("paper", {"world": {"drive": "kinematic"}, "radio": _QUIET}),
    "office": ("office", {}),
    "office, quiet": ("office", {"radio": {**_QUIET, "panel_rows": 8, "panel_cols": 8, "element_amplitude": 0.8}}),
    "OMA": ("office", {"radio": {"scheme": "oma", **_QUIET}}),
    "OMA that selects": ("office", {"radio": {"scheme": "oma", "oma_selection": True}}),
    "static order": ("office", {"radio": {"decoding_order": "static", **_QUIET}}),
    "six users, bodies block": ("office", {"world": {"num_users": 6, "body_blockage": True}}),
    "three clusters": ("office", {"world": {"num_users": 6}, "radio": {"num_clusters": 3, **_QUIET}}),
    "clinic, jittered": ("office", {"world": {"layout": "clinic", "layout_jitter_m": 0.1}}),
    "open, locked, csi": ("office", {"world": {"layout": "open", "pan": "locked"}, "task": {"observation": "csi"}}),
    "fixed": ("office", {"task": {"ris": "fixed"}}),
    "no RIS": ("office", {"task": {"ris": "none"}}),
    "random phases, panned": ("office", {"world": {"pan": "action"}, "task": {"phases": "random"}}),
    "held": ("office", {"task": {"phase_updates_per_slot": 2}, "radio": {"fading_memory": 0.7}}),
    "28 GHz": ("office", {"radio": {"carrier_hz": 28e9, "panel_rows": 16, "panel_cols": 16, **_QUIET}}),
    "cells differ": ("office", {"radio": {"difference_factor": 0.5, "fading_memory": 0.9}}),
}


@dataclass(frozen=True)
class Record:
    """Play everything, and keep what it gave."""

    file: tyro.conf.Positional[Path]


@dataclass(frozen=True)
class Compare:
    """Compare two records."""

    before: tyro.conf.Positional[Path]
    after: tyro.conf.Positional[Path]
    tolerance: float = 1e-9
    """Largest relative difference."""
    search_tolerance: float = 1e-3
    """The same for what a search found."""


def main(command: Record | Compare) -> int:
    """Record or compare."""
    if isinstance(command, Record):
        np.savez_compressed(command.file, **record())  # pyright: ignore[reportArgumentType]
        return 0
    return compare(command)


def case(name: str) -> Config:
    """The config of a case."""
    base, sections = CASES[name]
    config = replace(preset(base), seed=7)
    return replace(config, **{section: replace(getattr(config, section), **new) for section, new in sections.items()})


def record() -> dict[str, NDArray[np.floating]]:
    """Everything that is compared, by name."""
    found: dict[str, NDArray[np.floating]] = {}
    for name in CASES:
        found |= {f"{name}: {kind}": values for kind, values in stepped(case(name)).items()}
    for name in ("office", "office, quiet", "OMA", "OMA that selects", "static order", "held"):
        found |= {f"{name}: {kind}": values for kind, values in played(case(name)).items()}
    return found


def stepped(config: Config) -> dict[str, NDArray[np.floating]]:
    """Rates [T, E, K] and others of slots under random actions."""
    env, rng = make_vec(CELLS, config), np.random.default_rng(3)
    kept: dict[str, list[Any]] = {name: [] for name in ("observation", "reward", "rates", "bare", "blockers")}
    kept["observation"].append(env.reset())
    for _ in range(SLOTS):
        env.step_async(rng.uniform(-1, 1, (CELLS, env.action_space.shape[0])))  # pyright: ignore
        observation, reward, _, infos = env.step_wait()
        kept["observation"].append(observation)
        kept["reward"].append(reward)
        kept["rates"].append([info["rates_bps"] for info in infos])
        kept["bare"].append([info["bare_sum_rate_bps"] for info in infos])
        kept["blockers"].append([info["blockers"] for info in infos])
    env.close()
    return {name: np.array(values, np.float64) for name, values in kept.items()}


def played(config: Config) -> dict[str, NDArray[np.floating]]:
    """What policies get on some scenes, all of it [2, .], and the bound of their slots."""
    config, found = replace(config, task=replace(config.task, slots=PLAYED_SLOTS)), {}
    for policy in (reference_controls(), *reference_oma(), no_ris(), replace(planner(5), name=SEARCHED)):
        got = play(config, policy, SCENES, 11, bounded=True)
        numbers = {field.name: getattr(got, field.name) for field in fields(got)}
        found[policy.name] = np.array([np.ravel(value) for value in numbers.values() if np.size(value) == SCENES])
    return found


def compare(command: Compare) -> int:
    """Show the largest relative difference of every kind; 1 where one is too large or something is missing."""
    before, after = np.load(command.before), np.load(command.after)
    table, failed = Table("kind", "numbers", "largest relative difference"), set(before.files) != set(after.files)
    for name in sorted(set(before.files) & set(after.files)):
        a, b = before[name], after[name]
        same = a.shape == b.shape
        # Observations are single precision and of order one; rates may be zero.
        scale = np.maximum(np.abs(a), 1.0) if "observation" in name else np.maximum(np.abs(a), 1e-300)
        worst = float(np.max(np.abs(a - b) / scale, initial=0.0)) if same else np.inf
        allowed = command.search_tolerance if SEARCHED in name else command.tolerance
        allowed = max(allowed, 2e-6) if "observation" in name or "reward" in name else allowed
        failed |= not worst <= allowed
        table.add_row(name, str(a.size), f"{worst:.1e}" + ("" if worst <= allowed else "  too large"))
    console = Console()
    console.print(table)
    for name in sorted(set(before.files) ^ set(after.files)):
        console.print(f"{name}: only on one side", markup=False)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(tyro.conf.OmitSubcommandPrefixes[Record | Compare], description=__doc__)))  # pyright: ignore
