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
    assert list(table.policy[:4]) == list(experiment.RIVALS)
    assert len(learned) == 2 * 2 * 2
    assert set(learned.seed) == {1, 2}
    assert set(learned.episode) == {1, 2}
    assert path.with_suffix(".png").stat().st_size > 10_000
    closed = play(experiment.read(path).config, reference_controls(), 2, 7)
    np.testing.assert_allclose(table.sum_rate_mbps[1], closed.sum_rate_bps.mean() / 1e6, rtol=1e-5)
    np.testing.assert_allclose(table.penalised_mbps[1], closed.value_bps.mean() / 1e6, rtol=1e-5)
    np.testing.assert_allclose(table.sum_percent_of_planner[0], 100)
    assert "| learned, episode 2 |" in printed

    def never(*_: object) -> None:
        raise AssertionError("everything was finished")

    monkeypatch.setattr("judging.play", never)
    monkeypatch.setattr("mjris.learn.study._train_stack", never)
    experiment.main(study)
    pd.testing.assert_frame_equal(pd.read_csv(path.with_suffix(".csv")), table)


def test_intervals_are_students():
    # t of three seeds is 4.303 at 97.5 %, the standard error 1/sqrt(3).
    assert experiment._interval(pd.Series([1.0, 2.0, 3.0]), ".2f") == "2.00 ± 2.48"
    assert experiment._interval(pd.Series([1.0]), ".1f") == "1.0 ± –"


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
