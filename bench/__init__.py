"""The bench: plans and runs, errors, orders and work, the store, the command line."""
