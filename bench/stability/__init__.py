"""Stability analysis: amplification matrices of steps on linear systems, and their spectra."""
