"""Sentences and tables, made from records by rules."""
