"""Finding, writing and checking plugins: scenes and integrators."""
