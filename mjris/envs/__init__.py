"""The task as Gymnasium and Stable-Baselines3 know it, in one process or in several.

Only `sb3_vec` imports Stable-Baselines3.
"""
