"""Questions of a reader and their answers: who reaches an accuracy at the least cost, and where."""
