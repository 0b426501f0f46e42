"""Machinery of methods written as step functions: time loops, Newton's method, linear solvers."""
