"""What is measured: plan, run, errors and orders and work, store, command line."""
