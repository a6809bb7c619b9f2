"""The paper's figures from trained agents, with intervals, and its claims beside what is measured."""
