"""The radio: what links cost, channels, beams from what is known, rates over what is.

Compiled loops over NumPy arrays. Imports neither MuJoCo nor torch, and of the package only the config and `mjris.jit`.
"""
