"""Objects in worker processes, all asked at once."""

import io
import multiprocessing
import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import torch


class Remotes:
    """One object in each of several processes; what makes it must be importable by name.

    An exception in a process is raised here, once the others have finished what they were asked for, and `RuntimeError`
    where a process is gone.
    """

    def __init__(self, make: Callable[..., object], arguments: Sequence[tuple[Any, ...]]):
        # One executor a process, because a pool of several gives no say in which of them an object stays.
        # Spawned, because a fork of a process in which torch and OpenGL have threads may hang.
        context = multiprocessing.get_context("spawn")
        self._pools = [ProcessPoolExecutor(max_workers=1, mp_context=context) for _ in arguments]
        try:
            self._run(_make, [(make, each) for each in arguments])
        except BaseException:
            self.close()
            raise

    def call(self, method: str, *arguments: Any) -> list[Any]:
        """Call the method of every object with the same arguments: their results."""
        return self._run(_call, [(method, arguments)] * len(self._pools))

    def close(self) -> None:
        """End the processes."""
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    def _run(self, function: Callable[[bytes], bytes], messages: Sequence[Any]) -> list[Any]:
        # Pickled here, because torch would send tensors through shared file descriptors.
        futures = [pool.submit(function, _packed(message)) for pool, message in zip(self._pools, messages, strict=True)]
        try:
            return [pickle.loads(future.result()) for future in futures]
        except BrokenProcessPool:
            raise RuntimeError("a worker process of the training has ended by itself") from None


class _Pickler(pickle.Pickler):
    """Hands tensors over as arrays: torch packs every one of them like a file of its own, ten times as slowly."""

    def reducer_override(self, value: Any) -> Any:
        return (torch.from_numpy, (value.numpy(),)) if type(value) is torch.Tensor else NotImplemented


def _packed(message: Any) -> bytes:
    packed = io.BytesIO()
    _Pickler(packed, pickle.HIGHEST_PROTOCOL).dump(message)
    return packed.getvalue()


# What follows runs in the processes, each of which keeps its object here.
_own: Any


def _make(message: bytes) -> bytes:
    global _own
    make, arguments = pickle.loads(message)
    _own = make(*arguments)
    return _packed(None)


def _call(message: bytes) -> bytes:
    method, arguments = pickle.loads(message)
    return _packed(getattr(_own, method)(*arguments))
