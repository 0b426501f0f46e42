"""Models of MuJoCo and SymPy that are built in as scenes."""
