"""How loops over cells, users and elements are compiled, and elementary functions for them.

Knows nothing of radio or offices; imports Numba and nothing of the package.
"""
