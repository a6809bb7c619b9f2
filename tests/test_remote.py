import os
import pickle
import signal

import numpy as np
import pytest
import torch

from mjris.learn.remote import Remotes, _packed


class Counter:
    """Lives in a worker process."""

    def __init__(self, start: int):
        self._sum = torch.full((2, 3), float(start))

    def add(self, state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        self._sum += state["value"]
        return {"sum": self._sum, "count": state["count"] + 1}

    def die(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


def test_tensors_arrive_as_they_were_sent():
    sent = {
        "value": torch.arange(6, dtype=torch.float32).reshape(2, 3),
        "turned": torch.arange(6.0).reshape(2, 3).T,
        "count": torch.tensor(7),
        "nothing": torch.empty(0, 4),
        "other": [np.arange(3), "text", None],
    }
    arrived = pickle.loads(_packed(sent))
    for name in ("value", "turned", "count", "nothing"):
        assert arrived[name].dtype == sent[name].dtype
        torch.testing.assert_close(arrived[name], sent[name], rtol=0, atol=0)
    np.testing.assert_array_equal(arrived["other"][0], np.arange(3))
    assert arrived["other"][1:] == ["text", None]
    arrived["value"] += 1  # a copy of its own, which may be written to
    assert sent["value"][0, 0] == 0


def test_every_object_answers_from_its_own_process():
    counters = Remotes(Counter, [(1,), (10,)])
    state = {"value": torch.ones(2, 3), "count": torch.tensor(0)}
    counters.call("add", state)
    answers = counters.call("add", state)
    assert [answer["sum"][0, 0].item() for answer in answers] == [3, 12]
    assert [answer["count"].item() for answer in answers] == [1, 1]
    with pytest.raises(AttributeError, match="subtract"):
        counters.call("subtract", state)
    counters.close()


def test_a_process_that_is_gone_is_told_in_one_sentence():
    counters = Remotes(Counter, [(1,), (10,)])
    with pytest.raises(RuntimeError, match="a worker process of the training has ended by itself"):
        counters.call("die")
    counters.close()
