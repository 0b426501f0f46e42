"""Many runs as one compiled program: ensembles and maps of outcomes."""
