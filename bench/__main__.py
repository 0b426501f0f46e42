"""The program `stepbench`, also as ``python -m bench``: obeys Ctrl-C before anything else."""

from bench.guard.interrupts import obey


def main() -> None:
    """Run the command line."""
    obey()
    from bench.commands.main import main as command

    command(prog_name="stepbench")


if __name__ == "__main__":
    main()
