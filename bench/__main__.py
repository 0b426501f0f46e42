"""``python -m bench`` is the command ``stepbench``."""

from bench.cli import main

if __name__ == "__main__":
    main(prog_name="stepbench")
