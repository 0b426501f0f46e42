"""Scenes stated once more, as models of simulation engines."""
