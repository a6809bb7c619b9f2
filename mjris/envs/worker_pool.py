"""A task whose cells are spread over processes: this one and workers."""

import multiprocessing
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.envs.shared_arrays import Board
from mjris.simulation.constraints import Constraints
from mjris.simulation.scene import Slot
from mjris.simulation.streams import CellId
from mjris.simulation.task import Task

_AWAKE_S = 2e-3
"""How long a process looks for a message before it sleeps: to be woken takes it as long as several cells take."""


class Columns(NamedTuple):
    """What infos show of a slot, with an entry for every cell."""

    rates_bps: NDArray[np.floating]
    bare_sum_rate_bps: NDArray[np.floating]
    qos_met: NDArray[np.bool_]
    blockers: NDArray[np.int64]
    clearance_m: NDArray[np.floating]
    collisions: NDArray[np.int64]
    constraints: Constraints


class Part(NamedTuple):
    """What some of the cells give in a slot; all that travels between processes."""

    observation: NDArray[np.float32]
    """[E, D]"""
    reward: NDArray[np.floating]
    """[E], in `Task.rate_unit_bps`"""
    columns: Columns

    def arrays(self) -> list[NDArray[Any]]:
        """All arrays, of the columns too."""
        return [self.observation, self.reward, *self.columns[:-1], *self.columns.constraints]

    @classmethod
    def of(cls, arrays: Sequence[NDArray[Any]]) -> "Part":
        """From all arrays, as `arrays` gives them."""
        (observation, reward), rest = arrays[:2], arrays[2:]
        columns, constraints = rest[: -len(Constraints._fields)], rest[-len(Constraints._fields) :]
        return cls(observation, reward, Columns(*columns, constraints=Constraints(*constraints)))


def info_columns(slot: Slot) -> Columns:
    """What infos show of a slot."""
    return Columns(
        rates_bps=slot.rates_bps,
        bare_sum_rate_bps=slot.bare_rates_bps.sum(-1),
        qos_met=slot.qos_met,
        blockers=slot.scene.blockers,
        clearance_m=slot.clearance_m,
        collisions=slot.collisions,
        constraints=slot.constraints,
    )


def infos_of(columns: Columns) -> list[dict[str, Any]]:
    """The info of every cell."""
    rates, bare, met, blockers, clearance, collisions, constraints = columns
    cells = zip(
        rates,
        rates.sum(-1).tolist(),
        bare.tolist(),
        met,
        blockers,
        clearance.tolist(),
        collisions.tolist(),
        constraints.by_cell(),
        strict=True,
    )
    # A display takes a third of the time of dict(zip(names, values)).
    return [
        {
            "rates_bps": rates,
            "sum_rate_bps": total,
            "bare_sum_rate_bps": without,
            "qos_met": met,
            "blockers": blockers,
            "clearance_m": clearance,
            "collisions": collisions,
            "constraints": constraints,
        }
        for rates, total, without, met, blockers, clearance, collisions, constraints in cells
    ]


class SpreadTask:
    """A `Task` in several processes, of which this one has the first cells; the numbers are those of one task."""

    def __init__(self, config: Config, cells: Sequence[CellId], processes: int):
        self._slices = [slice(part[0], part[-1] + 1) for part in np.array_split(np.arange(len(cells)), processes)]
        self._own = Task(config, cells[self._slices[0]])
        self._others = [_Worker(config, cells[part]) for part in self._slices[1:]]
        for worker in self._others:
            worker.answer()  # it is ready
        self.observation_size, self.action_size = self._own.observation_size, self._own.action_size

    def reset(self, seeds: Sequence[int] | None) -> NDArray[np.float32]:
        """`Task.reset`, with a seed for every cell."""
        return np.concatenate(self._each("reset", [seeds and seeds[part] for part in self._slices]))

    def step(self, action: NDArray[np.floating]) -> list[Part]:
        """`Task.step`; the parts together are all cells, in order."""
        return self._each("step", [action[part] for part in self._slices])

    def close(self) -> None:
        """End the workers."""
        for worker in self._others:
            worker.close()

    def _each(self, method: Literal["reset", "step"], arguments: Sequence[Any]) -> list[Any]:
        for worker, argument in zip(self._others, arguments[1:], strict=True):
            worker.ask(method, argument)
        own = _call(self._own, method, arguments[0])
        return [own, *(worker.answer() for worker in self._others)]


class _Worker:
    """A task in a process of its own, which is asked first and answers later."""

    def __init__(self, config: Config, cells: Sequence[CellId]):
        # Spawned, because a fork of a process in which torch and OpenGL have threads may hang.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, config, cells), daemon=True)
        self._process.start()
        theirs.close()
        self._board: Board | None = None

    def ask(self, method: str, argument: Any) -> None:
        with _alive():
            self._pipe.send((method, argument))

    def answer(self) -> Any:
        with _alive():
            answer = _receive(self._pipe)
        if isinstance(answer, Exception):
            raise answer
        if isinstance(answer, Board):
            self._board = answer
        if answer is None or isinstance(answer, Board):
            assert self._board is not None
            return Part.of(self._board.read())
        return answer

    def close(self) -> None:
        self._pipe.close()
        self._process.join()
        if self._board is not None:
            self._board.close()


@contextmanager
def _alive() -> Iterator[None]:
    """Raises `RuntimeError` where a pipe has lost its other end."""
    try:
        yield
    except (EOFError, ConnectionError):
        raise RuntimeError("a worker process of the environment has ended by itself") from None


def _call(task: Task, method: str, argument: Any) -> Any:
    """`Task.reset` or `Task.step`, without what need not travel."""
    if method == "reset":
        return task.reset(argument)
    outcome = task.step(argument)
    return Part(outcome.observation, outcome.reward, info_columns(outcome.slot))


def _serve(pipe: Connection, config: Config, cells: Sequence[CellId]) -> None:
    """Answer what comes through the pipe until its other end is closed.

    Parts are left on a board, which is the first one's answer; that of the later ones is None.
    """
    board: Board | None = None
    try:
        task = Task(config, cells)
        pipe.send("ready")
        while True:
            method, argument = _receive(pipe)
            answer = _call(task, method, argument)
            if isinstance(answer, Part):
                arrays = answer.arrays()
                answer = None if board else (board := Board.like(arrays))
                board.write(arrays)
            pipe.send(answer)
    except (EOFError, KeyboardInterrupt):
        pass
    except Exception as error:
        pipe.send(error)
    finally:
        if board is not None:
            board.close()


def _receive(pipe: Connection) -> Any:
    """What comes through the pipe. Raises `EOFError` where its other end is closed."""
    asleep = time.perf_counter() + _AWAKE_S
    while not pipe.poll() and time.perf_counter() < asleep:
        pass
    return pipe.recv()
