"""Adapters: solvers of other libraries behind the integrator contract."""
