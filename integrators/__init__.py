"""How a scene is stepped: the integrator contract, the generalized-alpha family, adapters."""

from integrators.contract import (
    Integrator,
    PreparedRun,
    Steps,
    Tolerances,
    Trajectory,
    Work,
    option,
)

__all__ = ["Integrator", "PreparedRun", "Steps", "Tolerances", "Trajectory", "Work", "option"]
