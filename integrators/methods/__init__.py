"""The native methods, one file per family."""
