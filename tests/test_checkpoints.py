from dataclasses import replace

import numpy as np
import pytest

from mjris.config import preset
from mjris.eval.checkpoints import common_rounds, judge, spread
from mjris.eval.playing import play
from mjris.eval.policies import agent_policies
from mjris.simulation.task import Task

SCENES, SEED = 2, 5


@pytest.fixture
def runs(tmp_path):
    """Two run folders; the first one was stopped before its last, shorter round."""
    office = preset("classic")
    made = replace(
        office,
        world=replace(office.world, layout="clinic"),
        task=replace(office.task, slots=2),
        federation=replace(office.federation, episodes=10, round_episodes=4),
    )
    for name, rounds in (("a", 2), ("b", 3)):
        for round_ in range(1, rounds + 1):
            (tmp_path / name / "checkpoints" / f"round_{round_:04d}").mkdir(parents=True)
        (tmp_path / name / "config.json").write_text(made.to_json())
    return made, [tmp_path / "a", tmp_path / "b"]


def test_rounds_are_those_of_all_runs(runs):
    _, (a, b) = runs
    assert common_rounds([a, b]) == [1, 2]
    assert common_rounds([b]) == [1, 2, 3]


@pytest.mark.parametrize(
    ("count", "kept"), [(1, [1]), (3, [1, 2, 3]), (8, [*range(1, 9)]), (15, [1, 3, 5, 7, 9, 11, 13, 15])]
)
def test_few_rounds_are_kept_with_the_first_and_the_last(count, kept):
    assert spread(range(1, count + 1)) == kept


def test_checkpoints_are_played_on_the_scenes_of_the_rivals(runs):
    made, folders = runs
    size, heard = Task(made).action_size, []

    def act(run, round_):
        return lambda observation: np.full((len(observation), size), 0.1 * round_ - (run.name == "b"))

    judged = judge(made, folders, act, SCENES, SEED, heard.append)
    assert judged.episodes.tolist() == [4, 8]
    assert judge(made, folders[1:], act, SCENES, SEED, heard.append).episodes.tolist() == [4, 8, 10]
    assert heard[:4] == ["a after round 1", "b after round 1", "a after round 2", "b after round 2"]
    for c in range(2):
        for r, folder in enumerate(folders):
            alone = play(made, agent_policies(act(folder, c + 1))[0], SCENES, SEED)
            np.testing.assert_array_equal(judged.sum_rate_bps[c, r], alone.sum_rate_bps)
            np.testing.assert_array_equal(judged.bare_bps[c, r], alone.bare_bps)
