"""Runs and judgements that the studies here share: each is made once and kept in a folder."""

import json
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mjris.config import Config, load, preset
from mjris.eval.intervals import gain_percent
from mjris.eval.playing import play
from mjris.eval.policies import Policy, agent_policies, no_ris, planner, reference_controls
from mjris.learn.policy import load_policy
from mjris.learn.study import run_folder, train_missing

RIVALS = ("planner", "closed forms", "fixed RIS", "no RIS")
"""What agents are held against: the planner with the best phases and powers known, action zero, action zero without
driving, and the best powers known without RIS."""

Scores = dict[str, float]
Job = tuple[Any, ...]
"""A function that gives scores, importable by name, and its arguments."""


def progress() -> Progress:
    """A bar with the numbers of what is over and of what there is, and the time that this takes."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    return Progress(*columns, TimeRemainingColumn())


def train(configs: Sequence[Config], folder: Path) -> list[Path]:
    """`train_missing` with a bar over the episodes."""
    with progress() as shown:
        bar = shown.add_task("episodes of training", total=0)
        return train_missing(configs, folder, report=lambda done, total: shown.update(bar, completed=done, total=total))


def agent_scores(run: Path, episode: int, cell: int, scenes: int, seed: int) -> Scores:
    """How the agent of a cell of a run did after an episode, the last of a round."""

    def judge() -> Scores:
        config = load(run / "config.json")
        agent = load_policy(run, cell, round_=-(-episode // config.federation.round_episodes))
        learned = agent_policies(lambda observation: agent.predict(observation, deterministic=True)[0])[0]
        return _scores(config, replace(learned, changes={}), scenes, seed)  # in the task that it was trained for

    return kept(run / "judged" / f"learned_episode_{episode:04d}_cell_{cell}_{scenes}_{seed}.json", judge)


def rival_scores(config: Config, name: str, folder: Path, scenes: int, seed: int) -> Scores:
    """How one of `RIVALS` does."""

    def judge() -> Scores:
        closed = reference_controls()
        still = replace(closed, changes={"task": {**closed.changes["task"], "ris": "fixed"}})
        rivals: dict[str, Policy] = dict(zip(RIVALS, (planner(seed), closed, still, no_ris()), strict=True))
        return _scores(config, rivals[name], scenes, seed)

    words = name.replace(" ", "_")
    return kept(rival_file(config, folder, f"{words}_{scenes}_{seed}"), judge)


def rival_file(config: Config, folder: Path, name: str) -> Path:
    """Where something about a config is kept that depends on neither agents nor training."""
    plain = replace(config, agent=preset("office").agent, federation=preset("office").federation, seed=0)
    return folder / "rivals" / "judged" / f"{run_folder(plain, Path()).name}_{name}.json"


def kept(path: Path, judge: Callable[[], Scores]) -> Scores:
    """The scores in a file, which `judge` gives where it is not there yet."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(judge())
        unfinished = path.with_suffix(".unfinished")
        unfinished.write_text(text)
        unfinished.rename(path)
    return json.loads(path.read_text())


def each(jobs: Sequence[Job]) -> list[Scores]:
    """The scores of all jobs, in order and in parallel, with a bar; equal jobs are done once."""
    pool = ProcessPoolExecutor(mp_context=get_context("spawn"), initializer=torch.set_num_threads, initargs=(1,))
    with progress() as shown, pool:
        bar = shown.add_task("judgements", total=len(set(jobs)))
        futures = {job: pool.submit(job[0], *job[1:]) for job in dict.fromkeys(jobs)}
        for future in futures.values():
            future.add_done_callback(lambda _: shown.advance(bar))
        return [futures[job].result() for job in jobs]


def commit() -> str:
    """The commit of the code that ran, with a plus where files had changed since."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], capture_output=True, text=True, check=True).stdout.strip()

    return git("rev-parse", "--short", "HEAD") + (
        "+" if git("status", "--porcelain", "mjris", "scripts", "assets") else ""
    )


def _scores(config: Config, policy: Policy, scenes: int, seed: int) -> Scores:
    played = play(config, policy, scenes, seed)
    return {
        "sum_rate_mbps": played.sum_rate_bps.mean() / 1e6,
        "penalised_mbps": played.value_bps.mean() / 1e6,
        "qos_percent": 100 * played.qos_share.mean(),
        "gain_percent": float(gain_percent(played.sum_rate_bps.mean(), played.bare_bps.mean())),
        "collisions": played.collisions,
        "clearance_m": played.clearance_m,
    }
