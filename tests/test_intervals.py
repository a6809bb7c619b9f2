from typing import Any

import numpy as np
import pytest
from scipy import stats

from mjris.eval import intervals
from mjris.eval.intervals import gain_percent, interval


def mean(values: Any) -> Any:
    return values


def experiment(rng: np.random.Generator, seeds: int, scenes: int, of_seeds: float, of_scenes: float, of_both: float):
    """Values [R, S] with mean 10 and known components of their variance."""
    rows, columns = rng.standard_normal((seeds, 1)), rng.standard_normal((1, scenes))
    return 10 + of_seeds * rows + of_scenes * columns + of_both * rng.standard_normal((seeds, scenes))


def test_intervals_are_those_of_the_normal_distribution_for_many_scenes():
    rng = np.random.default_rng(1)
    values = rng.normal(3.0, 2.0, 1000)
    half = 1.96 * values.std() / np.sqrt(len(values))
    found = interval(mean, values, rng=rng)
    np.testing.assert_allclose(found, [values.mean() - half, values.mean() + half], atol=0.1 * half)


def test_seeds_alone_give_students_interval():
    rng = np.random.default_rng(2)
    seeds = rng.normal(3.0, 0.2, 12)
    half = stats.t.ppf(0.975, 11) * seeds.std(ddof=1) / np.sqrt(12)
    found = interval(mean, np.repeat(seeds[:, None], 30, 1), rng=rng)
    np.testing.assert_allclose(found, [seeds.mean() - half, seeds.mean() + half], atol=0.1 * half)


@pytest.fixture
def few_resamples(monkeypatch):
    """Enough where the mean of many intervals is looked at."""
    monkeypatch.setattr(intervals, "_RESAMPLES", 500)


@pytest.mark.usefixtures("few_resamples")
@pytest.mark.parametrize("components", [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.2, 2.0, 1.0), (0.0, 1.0, 0.0)])
def test_nineteen_of_twenty_intervals_have_the_truth(components: tuple[float, float, float]):
    """Five seeds and 32 scenes, as in what is reproduced; the binomial spread of 300 trials is 1.3 points."""
    rng = np.random.default_rng(3)
    ends = np.array([interval(mean, experiment(rng, 5, 32, *components), rng=rng) for _ in range(300)])
    covered = ((ends[:, 0] <= 10) & (ends[:, 1] >= 10)).mean()
    assert 0.91 <= covered <= 0.985


@pytest.mark.usefixtures("few_resamples")
def test_seeds_that_have_nothing_in_common_are_drawn_together_all_the_same():
    rng = np.random.default_rng(4)
    covered = 0
    for _ in range(300):
        scenes = rng.standard_normal(32)
        one, other = (experiment(rng, 5, 32, 0.5, 0, 0.5) + scenes for _ in range(2))
        low, high = interval(lambda one, other: one - other, one, other, rng=rng)
        covered += low <= 0 <= high
    assert 0.91 <= covered / 300 <= 0.985


def test_seeds_on_one_set_of_scenes_know_the_mean_no_better_than_the_scenes_do():
    """What an interval over seeds alone misses: all seeds are judged by the same luck."""
    rng = np.random.default_rng(5)
    scenes = rng.uniform(0.0, 4.0, 32)
    low, high = interval(mean, np.tile(scenes, (5, 1)), rng=rng)
    half = 1.96 * scenes.std() / np.sqrt(32)
    assert (high - low) / 2 == pytest.approx(half, rel=0.1)


def test_one_seed_is_an_interval_over_scenes():
    values = np.random.default_rng(6).uniform(1.0, 9.0, 32)
    plain, one = (interval(mean, sample, rng=np.random.default_rng(7)) for sample in (values, values[None]))
    assert plain == one


def test_what_is_paired_is_resampled_together():
    rng = np.random.default_rng(8)
    table = rng.uniform(0.1, 9.0, (5, 40))
    assert interval(gain_percent, table, table, rng=rng) == (0, 0)
    np.testing.assert_allclose(interval(gain_percent, 1.25 * table, table, rng=rng), (25, 25))
    low, high = interval(gain_percent, 1.25 * rng.permutation(table.ravel()).reshape(5, 40), table, rng=rng)
    assert low < 15 < 35 < high


def test_a_rival_without_seeds_stands_beside_agents():
    rng = np.random.default_rng(9)
    rival = rng.uniform(1.0, 9.0, 32)
    np.testing.assert_allclose(interval(gain_percent, 1.1 * np.tile(rival, (5, 1)), rival, rng=rng), (10, 10))


def test_curves_have_a_mean_for_every_point():
    rng = np.random.default_rng(10)
    curve = np.stack([np.full((3, 8), level) for level in (1.0, 3.0)])
    np.testing.assert_allclose(interval(lambda means: means[1] / means[0], curve, rng=rng), (3, 3))


def test_what_is_infinite_in_some_resamples_is_an_infinite_end():
    rng = np.random.default_rng(11)
    low, high = interval(lambda means: np.where(means > 0.5, np.inf, means), np.arange(10) / 9, rng=rng)
    assert 0 < low < 0.5
    assert high == np.inf


@pytest.mark.parametrize("other", [np.ones(7), np.ones((3, 8))])
def test_other_scenes_or_seeds_are_refused(other: np.ndarray):
    with pytest.raises(ValueError, match="share no seeds and scenes"):
        interval(gain_percent, np.ones((2, 8)), other, rng=np.random.default_rng(0))
