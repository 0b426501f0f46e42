"""``python -m bench`` is the command ``stepbench``."""

from bench.commands.main import main

if __name__ == "__main__":
    main(prog_name="stepbench")
