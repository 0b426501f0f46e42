"""Reference solutions and published digits."""
