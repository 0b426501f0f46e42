"""Below all else: JAX, the texts that name scenes, checks of answers, a cache on disk."""
