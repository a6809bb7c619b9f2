"""Runs and judgements that the studies here share: each is made once and kept in a folder, with its commits."""

import json
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mjris.config import Config, load, preset
from mjris.cores import CORES
from mjris.eval import parking
from mjris.eval.playing import play
from mjris.eval.policies import Policy, agent_policies, fixed_ris, no_ris, planner, reference_controls
from mjris.learn.policy import load_policy, without_noise
from mjris.learn.study import run_folder, train_missing

RIVALS = ("planner", "closed forms", parking.NAME, "fixed RIS", "no RIS")
"""What agents are held against: the planner with the best phases and powers known; action zero; closed forms at the
place that is best in other scenes, and where episodes start; and the best powers known without RIS."""

Scores = dict[str, Any]
"""How a policy did: arrays over the scenes [S], see `_scores`, what it did in all of them, and what it was judged and
trained at."""
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
        learned = agent_policies(without_noise(agent))[0]
        scores = _scores(config, replace(learned, changes={}), scenes, seed)  # in the task that it was trained for
        return scores | {"trained": trained_at(run)}

    return kept(run / "judged" / f"learned_episode_{episode:04d}_cell_{cell}_{scenes}_{seed}.json", judge)


def rival_scores(config: Config, name: str, folder: Path, scenes: int, seed: int) -> Scores:
    """How one of `RIVALS` does."""

    def judge() -> Scores:
        rivals: dict[str, Callable[[], Policy]] = {
            "planner": lambda: planner(seed),
            "closed forms": reference_controls,
            parking.NAME: lambda: parking.parked_at(parking.best_spot(config, seed)),
            "fixed RIS": fixed_ris,
            "no RIS": no_ris,
        }
        return _scores(config, rivals[name](), scenes, seed)

    words = name.replace(" ", "_")
    return kept(rival_file(config, folder, f"{words}_{scenes}_{seed}"), judge)


def rival_file(config: Config, folder: Path, name: str) -> Path:
    """Where something about a config is kept that depends on neither agents nor training."""
    plain = replace(config, agent=preset("classic").agent, federation=preset("classic").federation, seed=0)
    return folder / "rivals" / "judged" / f"{run_folder(plain, Path()).name}_{name}.json"


def trained_at(run: Path) -> str | None:
    """The commit that a run was trained at, as `commit` gives it; None where the run does not know."""
    provenance = run / "provenance.json"
    known: dict[str, Any] = json.loads(provenance.read_text()) if provenance.exists() else {"commit": None}
    return _label(known["commit"], known["dirty"]) if known["commit"] else None


def kept(path: Path, judge: Callable[[], Scores]) -> Scores:
    """The scores in a file, which `judge` gives where it is not there yet, with the commit that they were judged at."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(judge() | {"judged": commit()}, default=np.ndarray.tolist)
        unfinished = path.with_suffix(".unfinished")
        unfinished.write_text(text)
        unfinished.rename(path)
    scores = json.loads(path.read_text())
    return {name: np.array(value) if isinstance(value, list) else value for name, value in scores.items()}


def each(jobs: Sequence[Job]) -> list[Scores]:
    """The scores of all jobs, in order and in parallel, with a bar; equal jobs are done once."""
    context = get_context("spawn")
    pool = ProcessPoolExecutor(max_workers=CORES, mp_context=context, initializer=torch.set_num_threads, initargs=(1,))
    with progress() as shown, pool:
        bar = shown.add_task("judgements", total=len(set(jobs)))
        futures = {job: pool.submit(job[0], *job[1:]) for job in dict.fromkeys(jobs)}
        for future in futures.values():
            future.add_done_callback(lambda _: shown.advance(bar))
        return [futures[job].result() for job in jobs]


def commit() -> str:
    """The commit of the code that runs, with a plus where files have changed since."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], capture_output=True, text=True, check=True).stdout.strip()

    return _label(git("rev-parse", "HEAD"), bool(git("status", "--porcelain", "mjris", "scripts", "assets")))


def _label(name: str, dirty: bool) -> str:
    return name[:7] + ("+" if dirty else "")


def _scores(config: Config, policy: Policy, scenes: int, seed: int) -> Scores:
    played = play(config, policy, scenes, seed)
    return {
        "sum_rate_mbps": played.sum_rate_bps / 1e6,
        "bare_mbps": played.bare_bps / 1e6,
        "penalised_mbps": played.value_bps / 1e6,
        "qos_percent": 100 * played.qos_share,
        "user_qos_percent": 100 * played.user_qos_share,
        "user_rate_p5_kbps": played.user_rate_p5_bps / 1e3,
        "jain": played.jain,
        "superposing_percent": 100 * played.superposing_share,
        "collisions": played.collisions,
        "clearance_m": played.clearance_m,
    }
