import importlib
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mjris.config import ConfigError
from mjris.eval.evaluate import play
from mjris.eval.policies import reference_controls

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
experiment = importlib.import_module("experiment")
judging = importlib.import_module("judging")

TINY = """
what = "As short as it gets."
seeds = [1, 2]
judged = [1, 2]

[config.world]
layout = "open"

[config.task]
slots = 3

[config.agent]
warmup_slots = 2
batch_size = 2

[config.federation]
num_cells = 2
episodes = 2
round_episodes = 1
averaging = false
"""


def test_an_experiment_is_trained_judged_and_drawn_once(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr("judging.ProcessPoolExecutor", lambda **_: ThreadPoolExecutor(1))
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    study = experiment.Study(files=(path,), runs=tmp_path / "runs", scenes=2, scene_seed=7)
    experiment.main(study)
    printed = capsys.readouterr().out
    table = pd.read_csv(path.with_suffix(".csv"))
    learned = table[table.policy == "learned"]
    assert list(table.policy[:5]) == list(experiment.RIVALS)
    assert list(learned.episode) == [1, 2]
    assert (learned.seeds == 2).all()
    assert (table.scenes == 2).all()
    assert path.with_suffix(".png").stat().st_size > 10_000
    closed = play(experiment.read(path).config, reference_controls(), 2, 7)
    np.testing.assert_allclose(table.sum_rate_mbps[1], closed.sum_rate_bps.mean() / 1e6, rtol=1e-5)
    np.testing.assert_allclose(table.penalised_mbps[1], closed.value_bps.mean() / 1e6, rtol=1e-5)
    np.testing.assert_allclose(table.sum_rate_percent_of_planner[0], 100)
    assert "| learned, episode 2 |" in printed

    def never(*_: object) -> None:
        raise AssertionError("everything was finished")

    monkeypatch.setattr("judging.play", never)
    monkeypatch.setattr("mjris.learn.study._train_stack", never)
    experiment.main(study)
    pd.testing.assert_frame_equal(pd.read_csv(path.with_suffix(".csv")), table)


def judged(policy: str, seed: float, cell: float, episode: float, rate: list[float], **more: object):
    rates = np.array(rate)
    row = {"policy": policy, "seed": seed, "cell": cell, "episode": episode, "sum_rate_mbps": rates}
    scores = {"penalised_mbps": rates / 2, "bare_mbps": rates / 4, "qos_percent": 10 * rates}
    return row | scores | {"collisions": 1, "clearance_m": 0.1, "judged": "b"} | more


def test_a_point_is_a_mean_over_seeds_scenes_and_their_cells():
    nan = float("nan")
    agents = [
        judged("learned", 1, 0, 20, [1.0, 3.0], trained="a"),
        judged("learned", 1, 1, 20, [3.0, 3.0], trained="a"),
        judged("learned", 2, 0, 20, [2.0, 4.0], trained=None),
        judged("learned", 2, 1, 20, [2.0, 4.0], trained="c+"),
    ]
    table = experiment.summary(pd.DataFrame([judged("planner", nan, nan, nan, [4.0, 4.0]), *agents]), 0)
    planner, learned = table.to_dict("records")
    assert planner["seeds"] == 0
    assert planner["sum_rate_percent_of_planner"] == planner["sum_rate_percent_of_planner_low"] == 100
    assert learned["seeds"] == learned["scenes"] == 2
    assert learned["sum_rate_mbps"] == 2.75
    assert learned["sum_rate_percent_of_planner"] == 68.75
    assert learned["gain_percent"] == learned["gain_percent_low"] == learned["gain_percent_high"] == 300
    # By seed and scene the rates are 2, 3 and 2, 4: two scenes alone give 2 … 3.5, and two seeds much more.
    assert learned["sum_rate_mbps_low"] < 2
    assert learned["sum_rate_mbps_high"] > 3.5
    assert learned["sum_rate_mbps_by_seed"] == "2.5000 3.0000"
    assert learned["collisions"] == 4
    assert (learned["trained"], learned["judged"]) == ("a c+", "b")
    assert "worst seed 62.5 |" in experiment.markdown(table)


def test_kept_judgements_keep_the_commits_they_are_of(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(judging, "commit", lambda: "first")
    path = tmp_path / "judged" / "one.json"
    first = judging.kept(path, lambda: {"sum_rate_mbps": np.array([1.5, 2.0]), "collisions": 0})
    monkeypatch.setattr(judging, "commit", lambda: "second")
    again = judging.kept(path, lambda: {})
    for scores in (first, again):
        np.testing.assert_array_equal(scores["sum_rate_mbps"], [1.5, 2.0])
        assert scores["judged"] == "first"


@pytest.mark.parametrize(
    ("provenance", "said"),
    [
        (None, None),
        ('{"commit": null, "dirty": null}', None),
        ('{"commit": "0123456789abcdef", "dirty": false}', "0123456"),
        ('{"commit": "0123456789abcdef", "dirty": true}', "0123456+"),
    ],
)
def test_a_run_knows_the_commit_that_trained_it(tmp_path: Path, provenance: str | None, said: str | None):
    if provenance is not None:
        (tmp_path / "provenance.json").write_text(provenance)
    assert judging.trained_at(tmp_path) == said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds = [1]", "what is missing"),
        ("what = ", "cannot be read"),
        (TINY.replace("judged = [1, 2]", "judged = [3]"), "judged: 3 is not allowed"),
        (TINY.replace("slots = 3", "slots = 0"), r"task\.slots: 0 is not allowed"),
    ],
)
def test_bad_files_are_refused_in_one_sentence(tmp_path: Path, text: str, message: str):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        experiment.read(path)
