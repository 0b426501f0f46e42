"""Finding plugins, scenes and integrators alike, and telling when their source changes."""
