"""Newton's method and linear algebra of a step."""
