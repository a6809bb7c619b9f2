import multiprocessing
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import numpy as np
import pytest

from mjris.envs.shared_arrays import Board

ARRAYS = [np.arange(6.0).reshape(2, 3), np.array([True, False, True]), np.zeros((0, 4)), np.array([1.5], np.float32)]


def double(pipe: Connection) -> None:
    """Send a board with the double of what comes, and say so when it holds the double of that."""
    arrays = pipe.recv()
    board = Board.like([2 * array for array in arrays])
    for factor in (2, 4):
        board.write([factor * array for array in arrays])
        pipe.send(board if factor == 2 else None)
        pipe.recv()
    board.close()


def test_what_one_process_writes_another_reads_again_and_again():
    pipe, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=double, args=(theirs,), daemon=True)
    process.start()
    pipe.send(ARRAYS)
    board = pipe.recv()
    with pytest.raises(FileNotFoundError):  # the name is gone, so that nothing stays behind however the two end
        SharedMemory(board.__reduce__()[1][1])
    first = board.read()
    pipe.send("go on")
    assert pipe.recv() is None
    second = board.read()
    pipe.send("end")
    board.close()
    process.join()
    assert process.exitcode == 0
    for array, twice, four_times in zip(ARRAYS, first, second, strict=True):
        np.testing.assert_array_equal(twice, 2 * array)
        np.testing.assert_array_equal(four_times, 4 * array)
        assert twice.dtype == (2 * array).dtype


def test_only_arrays_of_the_same_shapes_fit():
    board = Board.like(ARRAYS)
    try:
        with pytest.raises(ValueError, match=r"board: an array of shape \(3, 2\) does not fit into \(2, 3\)"):
            board.write([ARRAYS[0].T, *ARRAYS[1:]])
        with pytest.raises(ValueError, match="shorter"):
            board.write(ARRAYS[:-1])
    finally:
        board.close()
        SharedMemory(board.__reduce__()[1][1]).unlink()
