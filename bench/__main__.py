"""The program `stepbench`, also as ``python -m bench``: obeys Ctrl-C before anything else."""

import sys

from bench.running.interrupts import obey


def main() -> None:
    """Run the command line."""
    obey()
    if sys.argv[1:2] == ["solve"] and len(sys.argv) > 3:
        from bench.running.process import start_ahead

        start_ahead("bench.running.worker")  # while this one reads the command line
    from bench.commands.main import main as command

    command(prog_name="stepbench")


if __name__ == "__main__":
    main()
