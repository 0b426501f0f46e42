"""Records of runs: their types, their store, and their comparison, union and summary."""
