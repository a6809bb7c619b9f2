"""Trained agents from their files: checkpoints of run folders, and exported policies."""

import shutil
from collections.abc import Callable
from pathlib import Path
from pickle import UnpicklingError
from zipfile import BadZipFile

import numpy as np
from gymnasium import Env
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from stable_baselines3 import DDPG

from mjris.config import Config, ConfigError, load
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.agent import build_agent
from mjris.learn.federation import EnvFactory
from mjris.learn.provenance import PROVENANCE

ACTOR = "actor.safetensors"

_DAMAGED = (ValueError, RuntimeError, BadZipFile, UnpicklingError, EOFError, LookupError, TypeError, AttributeError)
"""What reading a checkpoint raises that is cut, is something else, or holds other things than tensors by name."""


def load_policy(run_dir: Path, cell: int = 0, *, round_: int | None = None, make_env: EnvFactory = OfficeEnv) -> DDPG:
    """The agent of a cell from a checkpoint of a run folder, the last one by default, with an environment of that cell.

    Or the actor of an exported policy, for any cell. Built from the folder's config.json and then given the
    parameters. Raises `ConfigError` for a folder without config or checkpoint, an unknown cell, or parameters that do
    not fit the config.
    """
    if not run_dir.is_dir():
        raise ConfigError(f"run folder: {run_dir} does not exist")
    config = load(run_dir / "config.json")
    if not 0 <= cell < config.federation.num_cells:
        raise ConfigError(f"cell: {cell} is not allowed: {run_dir} has cells 0 to {config.federation.num_cells - 1}")
    if (run_dir / ACTOR).is_file():
        return _exported(run_dir, config, make_env(config, cell))
    rounds = "*" if round_ is None else f"{round_:04d}"
    checkpoints = (run_dir / "checkpoints").glob(f"round_{rounds}/cell_{cell}.zip")
    last = max(checkpoints, key=lambda path: int(path.parent.name.removeprefix("round_")), default=None)
    if last is None:
        of_round = "" if round_ is None else f" of round {round_}"
        raise ConfigError(f"run folder: {run_dir} has no checkpoint of cell {cell}{of_round}")
    agent = build_agent(config, make_env(config, cell), np.random.default_rng())
    try:
        agent.set_parameters(str(last), device="cpu")
    except _DAMAGED:
        raise ConfigError(f"{last}: is damaged or does not fit {run_dir / 'config.json'}") from None
    return agent


def without_noise(agent: DDPG) -> Callable[[NDArray[np.float32]], NDArray[np.floating]]:
    """What an agent does without exploring: actions [E, A] for observations [E, D]."""
    return lambda observations: agent.predict(observations, deterministic=True)[0]


def export_policy(run_dir: Path, out: Path, cell: int = 0, *, make_env: EnvFactory = OfficeEnv) -> list[Path]:
    """Write what acting needs of a cell's last agent to `out`, config.json and actor.safetensors; returns the paths.

    The run's provenance.json goes with them where it has one. Raises what `load_policy` raises, and `ConfigError` where
    one of the files exists.
    """
    origin = run_dir / PROVENANCE
    paths = [out / "config.json", out / ACTOR, *([out / PROVENANCE] if origin.exists() else [])]
    for path in paths:
        if path.exists():
            raise ConfigError(f"out: {out} is not allowed: {path.name} exists there already")
    agent = load_policy(run_dir, cell, make_env=make_env)
    out.mkdir(parents=True, exist_ok=True)
    save_file(agent.actor.state_dict(), paths[1])
    paths[0].write_text(load(run_dir / "config.json").to_json())
    if origin.exists():
        shutil.copyfile(origin, paths[2])
    return paths


def _exported(folder: Path, config: Config, env: Env) -> DDPG:
    agent = build_agent(config, env, np.random.default_rng())
    try:
        agent.actor.load_state_dict(load_file(folder / ACTOR))
    except (SafetensorError, RuntimeError):
        raise ConfigError(f"{folder / ACTOR}: is damaged or does not fit {folder / 'config.json'}") from None
    return agent
