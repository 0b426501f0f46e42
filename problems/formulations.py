"""The equations of a scene as an ODE or a DAE, for integrators of other libraries."""

from problems.equations.formulations import complete as complete
from problems.equations.formulations import dae_layout as dae_layout
from problems.equations.formulations import dae_residual as dae_residual
from problems.equations.formulations import ode_rate as ode_rate
