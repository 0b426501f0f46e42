"""The command `stepbench` and its groups of commands."""

from __future__ import annotations

import click

from bench.commands import (
    completion,
    listing,
    options,
    orders_table,
    plugins,
    results,
    scenes,
    single_runs,
    studies,
    suite,
    sweeps,
)


@click.group(
    cls=options.ShortErrors,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  stepbench run
  stepbench solve pendulum "generalized_alpha[rho_inf=0.8]" --step 0.01
  stepbench order pendulum newmark --steps 0.02,0.01,0.005,0.0025
  stepbench run -i my_method --plugins my_method.py
  stepbench new integrator my_method && stepbench check my_method.py

"""
    + completion.SWITCH_ON,
)
@click.version_option(package_name="stepbench")
def main() -> None:
    """Compare time integrators for mechanical and mechatronic systems.

    Positions, velocities, accelerations, multipliers and controller states are compared
    separately, against the work that each integrator does for them.
    """


for command in (
    *(listing.list_, plugins.check, plugins.new, scenes.show, scenes.catalogue),
    *(single_runs.solve, single_runs.order, suite.run, suite.report),
    *(
        results.export,
        results.compare_,
        results.merge_,
        results.history_,
        results.open_,
        results.figure,
        results.card,
        results.choose,
    ),
    *(studies.stability, orders_table.orders_table, studies.drift, studies.atlas, sweeps.map_),
):
    main.add_command(command)
