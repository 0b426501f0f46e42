"""Guarded processes: foreign code runs in them, within budgets, and ends with this process."""
