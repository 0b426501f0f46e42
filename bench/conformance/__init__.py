"""The conformance kit: the checks that every scene and integrator has to pass."""
