"""One step: its equations, first guesses, options and work."""
