"""For notebooks and scripts: ``from bench import solve, order, run, load``.

The same runs as those of the command line, with their numbers as arrays and pandas frames:

>>> from bench import solve
>>> found = solve("pendulum", "generalized_alpha[rho_inf=0.8]", step=0.01)
>>> found.a.shape[1], found.status
(2, 'ok')
"""

from bench.notebook.answers import Orders as Orders
from bench.notebook.answers import Results as Results
from bench.notebook.answers import Solution as Solution
from bench.notebook.functions import load as load
from bench.notebook.functions import order as order
from bench.notebook.functions import run as run
from bench.notebook.functions import solve as solve
