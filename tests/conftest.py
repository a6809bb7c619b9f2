import pytest
from hypothesis import settings

from mjris import streams

# A first example waits for the compiler; how fast things are is for scripts/bench.py to say.
settings.register_profile("mjris", deadline=None)
settings.load_profile("mjris")


@pytest.fixture(autouse=True)
def unnamed_seed(monkeypatch, request):
    """What a test leaves unseeded is the same in every run, but where it is marked to ask for fresh entropy."""
    if "fresh_entropy" not in request.keywords:
        monkeypatch.setattr(streams, "fresh_seed", lambda: 0)
