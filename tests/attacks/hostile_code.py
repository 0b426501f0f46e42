"""Pieces of hostile code, and the words that several plugins have in common."""

from __future__ import annotations

#: Reasons that several plugins have in common.
SLEPT, BUSY = "it did nothing for", "s of processor time, its budget"
#: A fate that depends on who meets the fault first.
LOST = "lost or crashed"
#: A fate that depends on the machine; the other cells are watched.
ANY = "any"
TWICE = (  # acts in each process but the first that loads it
    "from pathlib import Path\nmark = Path(__file__).with_suffix('.loaded')\n"
    "if mark.exists(): {0}\nmark.touch()"
)
CLASS = (
    "class {0}(Integrator):\n    'Odd.'\n    formulation = 'ode'\n    def prepare(self, *a): 1 / 0"
)
HOLD = "ctypes.PyDLL(None).sleep(3600)"
SPIN = "while True: pass"
