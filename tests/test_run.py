import json
import pickle
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from toy import BrokenToyEnv, ToyEnv, toy_config

from mjris.config import ConfigError, load
from mjris.learn.federation import Cell, EpisodeMetrics, average
from mjris.learn.policy import load_policy
from mjris.learn.progress import progress_bar, summary
from mjris.learn.run import train


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory):
    """A run folder and what was reported while it was made."""
    out = tmp_path_factory.mktemp("runs") / "new" / "run"
    reports: list[list[EpisodeMetrics]] = []
    train(toy_config(), out, report=reports.append, make_env=ToyEnv)
    return out, reports


def states(run_dir: Path) -> list[dict[str, torch.Tensor]]:
    return [dict(load_policy(run_dir, u, make_env=ToyEnv).policy.state_dict()) for u in (0, 1)]


def test_run_folder_has_its_parts(finished):
    out, _ = finished
    parts = ["checkpoints", "config.json", "metrics.csv", "provenance.json", "tensorboard"]
    assert sorted(path.name for path in out.iterdir()) == parts
    made_by = json.loads((out / "provenance.json").read_text())
    assert made_by["backend"] == "2 cells learn one after the other in this process"
    assert load(out / "config.json") == toy_config()
    zips = sorted(str(path.relative_to(out / "checkpoints")) for path in out.glob("checkpoints/*/*"))
    assert zips == [f"round_000{round_}/cell_{u}.zip" for round_ in (1, 2, 3) for u in (0, 1)]


def test_metrics_have_a_row_an_episode_and_cell(finished):
    out, reports = finished
    table = pd.read_csv(out / "metrics.csv")
    assert list(table.columns) == [
        *("round", "episode", "cell", "reward", "sum_rate_mbps", "bare_rate_mbps", "qos_share"),
        *("collisions", "clearance_m"),
    ]
    assert table["round"].tolist() == [1] * 4 + [2] * 4 + [3] * 2
    assert table["episode"].tolist() == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert table["cell"].tolist() == [0, 1] * 5
    assert [len(report) for report in reports] == [4, 4, 2]
    reported = [row for report in reports for row in report]
    np.testing.assert_array_equal(table["reward"], [row.reward for row in reported])
    np.testing.assert_array_equal(table["clearance_m"], [row.clearance_m for row in reported])


def test_the_run_is_rounds_of_cells_and_averages(finished):
    out, _ = finished
    cells = [Cell(toy_config(), u, ToyEnv) for u in (0, 1)]
    merged = None
    for round_ in (1, 2, 3):
        merged = average([cell.train(round_, merged)[0] for cell in cells])
    assert merged is not None
    for state in states(out):  # the last checkpoint holds the last average, in every cell
        assert state.keys() == merged.keys()
        assert all(torch.equal(state[key], merged[key]) for key in merged)


def test_tensorboard_has_a_point_an_episode(finished):
    out, _ = finished
    table = pd.read_csv(out / "metrics.csv")
    for u in (0, 1):
        events = EventAccumulator(str(out / "tensorboard" / f"cell_{u}"))
        events.Reload()
        own = table[table["cell"] == u]
        gain = 100 * (own.sum_rate_mbps / own.bare_rate_mbps - 1)
        for name, expected in (("sum_rate_mbps", own.sum_rate_mbps), ("gain_percent", gain)):
            points = events.Scalars(f"episode/{name}")
            assert [point.step for point in points] == [10, 20, 30, 40, 50]
            np.testing.assert_allclose([point.value for point in points], expected, rtol=1e-6)


def test_loaded_policy_acts_and_lasts(finished):
    out, _ = finished
    agent = load_policy(out, 1, make_env=ToyEnv)
    action, _ = agent.predict(np.array([0.5, -0.5], dtype=np.float32))
    assert action.shape == (2,)
    assert np.all(np.abs(action) <= 1)


@pytest.mark.parametrize(("averaging", "num_cells"), [(False, 2), (True, 1)])
def test_without_averaging_cells_stay_on_their_own(tmp_path: Path, averaging: bool, num_cells: int):
    config = toy_config(averaging=averaging, num_cells=num_cells)
    train(config, tmp_path, make_env=ToyEnv)
    for u in range(num_cells):
        cell = Cell(config, u, ToyEnv)
        for round_ in (1, 2, 3):
            expected, _ = cell.train(round_, None)
        state = load_policy(tmp_path, u, make_env=ToyEnv).policy.state_dict()
        assert all(torch.equal(state[key], expected[key]) for key in expected)


def test_a_folder_in_use_is_refused_and_left_alone(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="needs a new or empty folder"):
        train(toy_config(), tmp_path, make_env=ToyEnv)
    with pytest.raises(ConfigError, match="needs a new or empty folder"):
        train(toy_config(), tmp_path / "notes.txt", make_env=ToyEnv)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_run_that_fails_leaves_its_config_and_no_half_checkpoint(tmp_path: Path):
    with pytest.raises(ArithmeticError):
        train(toy_config(), tmp_path, make_env=BrokenToyEnv)
    assert (tmp_path / "config.json").exists()
    with pytest.raises(ConfigError, match="has no checkpoint of cell 0"):
        load_policy(tmp_path, make_env=ToyEnv)


def test_loading_refuses_what_is_not_there(finished, tmp_path: Path):
    out, _ = finished
    with pytest.raises(ConfigError, match="does not exist"):
        load_policy(tmp_path / "nowhere", make_env=ToyEnv)
    with pytest.raises(ConfigError, match=r"config\.json: cannot be read"):
        load_policy(tmp_path, make_env=ToyEnv)
    with pytest.raises(ConfigError, match="cell: 2 is not allowed"):
        load_policy(out, 2, make_env=ToyEnv)


@pytest.mark.parametrize("damage", ["config", "cut"])
def test_loading_refuses_a_checkpoint_that_does_not_fit(finished, tmp_path: Path, damage: str):
    out, _ = finished
    folder = tmp_path / "checkpoints" / "round_0001"
    folder.mkdir(parents=True)
    content = (out / "checkpoints" / "round_0003" / "cell_0.zip").read_bytes()
    (folder / "cell_0.zip").write_bytes(content if damage == "config" else content[: len(content) // 2])
    agent = {"hidden": (16,)} if damage == "config" else None
    (tmp_path / "config.json").write_text(toy_config(agent=agent).to_json())
    with pytest.raises(ConfigError, match="is damaged or does not fit"):
        load_policy(tmp_path, make_env=ToyEnv)


@pytest.mark.parametrize("held", [pickle.dumps(print), pickle.dumps([1]), pickle.dumps({"actor": 1}), b"", b"text"])
def test_loading_refuses_a_checkpoint_of_anything_but_tensors(finished, tmp_path: Path, held: bytes):
    out, _ = finished
    path = tmp_path / "checkpoints" / "round_0001" / "cell_0.zip"
    path.parent.mkdir(parents=True)
    with ZipFile(out / "checkpoints" / "round_0003" / "cell_0.zip") as whole, ZipFile(path, "w") as changed:
        for name in whole.namelist():
            changed.writestr(name, held if name == "policy.pth" else whole.read(name))
    (tmp_path / "config.json").write_text(toy_config().to_json())
    with pytest.raises(ConfigError, match="is damaged or does not fit"):
        load_policy(tmp_path, make_env=ToyEnv)


def row(episode: int, sum_rate_mbps: float, qos_share: float, collisions: int) -> EpisodeMetrics:
    return EpisodeMetrics(
        round=1,
        episode=episode,
        cell=0,
        reward=0.0,
        sum_rate_mbps=sum_rate_mbps,
        bare_rate_mbps=1.0,
        qos_share=qos_share,
        collisions=collisions,
        clearance_m=0.1,
    )


def test_progress_says_where_the_run_is(capsys: pytest.CaptureFixture):
    metrics = [row(1, 1.0, 0.5, 0), row(2, 2.0, 1.0, 3)]
    assert summary(metrics) == "1.500 Mb/s · QoS 75% · 3 collisions"
    with progress_bar(toy_config(episodes=4)) as report:
        report(metrics)
    assert "2/4" in capsys.readouterr().out
