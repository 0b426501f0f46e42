"""Traced functions of numbers as straight-line C, compiled and loaded into this process."""
