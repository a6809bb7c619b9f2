"""Every cell stepped together once a slot, and the agents' side of it: observations, actions, rewards.

The order of a slot stands in `simulator`; random streams in `streams`. Imports no learner and no environment.
"""
