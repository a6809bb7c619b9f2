from concurrent.futures import Future
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from threading import Timer

import pandas as pd
import pytest
from toy import BrokenToyEnv, ToyEnv, toy_config

from mjris.config import Config, preset
from mjris.learn.policy import load_policy
from mjris.learn.study import _stacks, _wait, run_folder, train_missing


def silent(done: int, total: int) -> None:
    """Report nothing."""


def test_only_what_is_missing_is_trained(tmp_path: Path):
    configs = [toy_config(seed=seed) for seed in (3, 4)]
    heard = []

    def report(done: int, total: int) -> None:
        heard.append((done, total))

    first = train_missing(configs[:1], tmp_path, report=report, make_env=ToyEnv)
    assert heard[-1] == (10, 10)  # two cells, five episodes
    written = (first[0] / "metrics.csv").stat().st_mtime_ns
    other = replace(configs[0], agent=replace(configs[0].agent, learning_rate=1e-2))
    heard.clear()
    everything = train_missing([*configs, other], tmp_path, report=report, make_env=ToyEnv)
    assert heard[-1] == (20, 20)
    assert everything[0] == first[0] == run_folder(configs[0], tmp_path)
    assert (everything[0] / "metrics.csv").stat().st_mtime_ns == written
    assert len(set(everything)) == 3
    for config, run in zip([*configs, other], everything, strict=True):
        assert (run / "config.json").read_text() == config.to_json()
        assert load_policy(run, make_env=ToyEnv).learning_rate == config.agent.learning_rate
        assert len(pd.read_csv(run / "metrics.csv")) == 10
    assert sorted(tmp_path.iterdir()) == sorted(everything)


def test_a_stack_that_fails_leaves_no_runs(tmp_path: Path):
    with pytest.raises(ArithmeticError, match="gave way"):
        train_missing([toy_config()], tmp_path, report=silent, make_env=BrokenToyEnv)
    assert not list(tmp_path.iterdir())
    (run,) = train_missing([toy_config()], tmp_path, report=silent, make_env=ToyEnv)
    assert len(pd.read_csv(run / "metrics.csv")) == 10


class LateFuture(Future):
    """Is over just when whoever waits for it has given up."""

    def result(self, timeout: float | None = None):
        if timeout is not None:
            super().result()
            raise TimeoutError
        return super().result()


def test_a_stack_that_is_over_when_its_time_is_out_is_no_failure():
    late: Future[None] = LateFuture()
    queue = get_context("spawn").SimpleQueue()
    queue.put(3)
    heard = []
    timer = Timer(0.05, late.set_result, [None])
    timer.start()
    _wait([late], queue, heard.append)
    assert heard[-1] == 3
    timer.join()


def test_a_time_out_within_a_stack_is_one():
    failed: Future[None] = Future()
    failed.set_exception(TimeoutError("no answer"))
    with pytest.raises(TimeoutError, match="no answer"):
        _wait([failed], get_context("spawn").SimpleQueue(), lambda _: None)


def with_seed(config: Config, seed: int, **radio: object) -> Config:
    return replace(config, seed=seed, radio=replace(config.radio, **radio))


def test_stacks_hold_like_runs_and_busy_all_cores():
    base = replace(preset("classic"), federation=replace(preset("classic").federation, num_cells=3))
    runs = [with_seed(base, seed) for seed in range(5)]
    assert _stacks(runs, 1) == [runs]
    assert sorted(len(stack) for stack in _stacks(runs, 2)) == [2, 3]
    powers, loud = ([with_seed(base, seed, tx_power_dbm=power) for seed in range(5)] for power in (30.0, 40.0))
    # 30 agents, at most 20 a stack.
    assert sorted(len(stack) for stack in _stacks([*runs, *powers], 1)) == [5, 5]
    # 45 agents: two stacks for each of two cores, and not three.
    assert sorted(len(stack) for stack in _stacks([*runs, *powers, *loud], 2)) == [3, 4, 4, 4]
    wide = [with_seed(base, seed, panel_cols=8) for seed in range(5)]
    mixed = _stacks([*runs, *wide], 1)
    assert mixed == [runs, wide]
    everything = [*runs, *powers, *wide]
    assert {config for stack in _stacks(everything, 2) for config in stack} == set(everything)


def test_nothing_missing_is_nothing_to_do(tmp_path: Path):
    assert train_missing([], tmp_path, report=silent) == []
