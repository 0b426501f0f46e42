"""The conformance kit: what every scene and integrator has to hold to, each said in a sentence."""
