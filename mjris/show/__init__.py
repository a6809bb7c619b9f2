"""Videos and pictures of what was simulated."""
