from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from toy import ToyEnv, toy_config

from mjris.learn.policy import load_policy
from mjris.learn.study import run_folder, train_missing


def silent(*_: object) -> None:
    """Report nothing."""


def test_only_what_is_missing_is_trained(tmp_path: Path):
    configs = [toy_config(seed=seed) for seed in (3, 4)]
    rounds = []
    first = train_missing(configs[:1], tmp_path, report=lambda *args: rounds.append(args[:2]), make_env=ToyEnv)
    assert rounds == [(1, 1)] * 3
    written = (first[0] / "metrics.csv").stat().st_mtime_ns
    other = replace(configs[0], agent=replace(configs[0].agent, learning_rate=1e-2))
    rounds.clear()
    both = train_missing([*configs, other], tmp_path, report=lambda *args: rounds.append(args[:2]), make_env=ToyEnv)
    assert rounds == [(1, 2)] * 3 + [(2, 2)] * 3
    assert both[0] == first[0] == run_folder(configs[0], tmp_path)
    assert (both[0] / "metrics.csv").stat().st_mtime_ns == written
    assert len(set(both)) == 3
    for config, run in zip([*configs, other], both, strict=True):
        assert (run / "config.json").read_text() == config.to_json()
        assert load_policy(run, make_env=ToyEnv).learning_rate == config.agent.learning_rate
        assert len(pd.read_csv(run / "metrics.csv")) == 10
    assert sorted(tmp_path.iterdir()) == sorted(both)


def test_an_interrupted_stack_leaves_no_runs_and_starts_again(tmp_path: Path):
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_missing([toy_config()], tmp_path, report=interrupt, make_env=ToyEnv)
    assert not list(tmp_path.iterdir())
    (run,) = train_missing([toy_config()], tmp_path, report=silent, make_env=ToyEnv)
    assert len(pd.read_csv(run / "metrics.csv")) == 10
