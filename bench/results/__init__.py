"""Records of runs: their types, their store, and what is made of them."""
