"""How loops over cells, people and bricks are compiled: array operations on so few numbers are all overhead."""

import numba

compiled = numba.njit(cache=True, error_model="numpy")
"""Compiles a function of arrays and numbers when it is first called, and keeps the result on disk.

A division by zero gives inf or nan, as in NumPy.
"""
