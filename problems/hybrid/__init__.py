"""Values that jump: events, samples and contact."""
