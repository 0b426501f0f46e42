"""The checks that every scene and integrator has to pass."""
