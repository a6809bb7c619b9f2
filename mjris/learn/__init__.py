"""Learning: agents, and their federation over cells."""
