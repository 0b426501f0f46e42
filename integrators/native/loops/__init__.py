"""Loops over steps, compiled, and how runs end."""
