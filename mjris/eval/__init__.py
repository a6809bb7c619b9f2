"""Held-out scenes: policies side by side, with intervals."""
