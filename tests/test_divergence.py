import math
from pathlib import Path

import numpy as np
import pytest
import torch
from toy import ToyEnv, toy_config

from mjris.config import Config, ConfigError
from mjris.learn.divergence import Diverged, non_finite
from mjris.learn.run import train, train_many
from mjris.learn.spread import StackedCells
from mjris.learn.study import train_missing
from mjris.learn.workers import LocalCells, open_cells

RATE = 1e30
"""At which a weight squared is no number of single precision."""
SENTENCE = (
    r"agent\.learning_rate: 1e\+30 is not allowed: the agent of cell 0 \(seed 0\) diverged in episode 2, .*: lower"
)


def hopeless(**changes) -> Config:
    """The first update is in the second episode."""
    return toy_config(agent={"learning_rate": RATE, "warmup_slots": 14}, **changes)


class ProudToyEnv(ToyEnv):
    """Takes no action that is no number."""

    def step(self, action: np.ndarray):
        assert np.isfinite(action).all()
        return super().step(action)


@pytest.mark.parametrize("network", ["mlp", "paper"])
@pytest.mark.parametrize(
    "federation", [{"backend": "stacked"}, {"backend": "processes"}, {"backend": "processes", "workers": 2}]
)
def test_every_backend_says_who_diverged_and_when(federation: dict, network: str, tmp_path: Path):
    config = toy_config(agent={"learning_rate": RATE, "warmup_slots": 14, "network": network}, **federation)
    with pytest.raises(Diverged, match=SENTENCE):
        train(config, tmp_path, make_env=ProudToyEnv)
    assert len((tmp_path / "metrics.csv").read_text().splitlines()) == 1
    assert not (tmp_path / "checkpoints").exists()


def test_rounds_before_are_kept_whole(tmp_path: Path):
    config = toy_config(agent={"learning_rate": RATE, "warmup_slots": 24})
    for backend in ("stacked", "processes"):
        out = tmp_path / backend
        with pytest.raises(ConfigError, match="diverged in episode 3"):
            train(config, out, make_env=ProudToyEnv)
        assert len((out / "metrics.csv").read_text().splitlines()) == 1 + 2 * 2
        assert [path.name for path in (out / "checkpoints").iterdir()] == ["round_0001"]


def test_a_stack_of_runs_names_the_run(tmp_path: Path):
    configs = [toy_config(agent={"warmup_slots": 14}, seed=4), hopeless(seed=5)]
    outs = [tmp_path / "good", tmp_path / "bad"]
    with pytest.raises(Diverged, match=r"cell 0 \(seed 5\)"):
        train_many(configs, outs, make_env=ProudToyEnv)
    for out in outs:
        assert len((out / "metrics.csv").read_text().splitlines()) == 1


def test_the_sentence_comes_out_of_a_study(tmp_path: Path):
    with pytest.raises(Diverged, match=SENTENCE):
        train_missing([hopeless()], tmp_path, report=lambda *_: None, make_env=ProudToyEnv)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("entry", ["actor.mu.0.weight", "critic_target.qf0.2.bias"])
def test_one_bad_number_in_any_network_is_seen_before_it_is_shared(entry: str, bad: float, monkeypatch):
    monkeypatch.setattr("mjris.learn.federation.average", lambda states: states[0])
    config = toy_config()
    for cells in (StackedCells(config, ToyEnv, None), LocalCells(config, range(2), ToyEnv, None)):
        state = {name: tensor.clone() for name, tensor in cells.train(1, None)[0][0].items()}
        state[entry].view(-1)[0] = bad
        with pytest.raises(Diverged, match="cell 0"):
            cells.train(2, state)
        cells.close()


def test_the_first_bad_entry_is_named():
    good = {"a": torch.ones(2), "count": torch.tensor(3)}
    assert non_finite(good) is None
    assert non_finite(good | {"b": torch.tensor([1.0, -math.inf])}) == "b"


def test_workers_pass_the_sentence_on():
    cells = open_cells(hopeless(backend="processes", workers=2), ToyEnv)
    with pytest.raises(Diverged) as raised:
        cells.train(1, None)
    cells.close()
    assert "\n" not in str(raised.value)
