import pytest
from hypothesis import settings

from mjris.simulation import streams

# A first example waits for the compiler; how fast things are is for scripts/bench.py to say.
settings.register_profile("mjris", deadline=None)
settings.load_profile("mjris")

_from_entropy = streams.fresh_seed


@pytest.fixture(autouse=True, scope="session")
def unnamed_seeds():
    """What a test leaves unseeded is the same in every run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streams, "fresh_seed", lambda: 0)
        yield


@pytest.fixture
def fresh_entropy(monkeypatch):
    """Unnamed seeds as users have them."""
    monkeypatch.setattr(streams, "fresh_seed", _from_entropy)
