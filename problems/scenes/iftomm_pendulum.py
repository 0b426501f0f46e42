"""A01 of the IFToMM benchmark library: the simple pendulum, by the rule of its named point."""

from __future__ import annotations

from dataclasses import dataclass

from problems import Published, jax
from problems.scenes.pendulum import Pendulum


@dataclass(frozen=True)
class IFToMMPendulum(Pendulum):
    """A point mass falls from rest beside its pivot: the benchmark A01 of the IFToMM library.

    The specification asks for 2000 s (`--t-end 2000`), the library's page for 10 s from the other
    side. Tests how errors of the period and of the energy add up. The motion is that of `pendulum`
    with its closed form; the digits were computed from it with 30 digits.
    """

    name = "iftomm_pendulum"
    interval = (0.0, 10.0)
    nominal_step = 0.02
    tags = ("constrained", "index 3", "closed form", "conservative", "benchmark")
    source = "IFToMM benchmark library, A01; Gonzalez et al. (2006), doi:10.1007/s11044-006-9013-y"
    published = (
        Published("P", 1.0, (-0.986291751131875319, -0.165010853125541169), 1e-13),
        Published("P", 5.0, (0.942305435043757335, -0.334754338414000581), 1e-13),
        Published("P", 10.0, (0.27508746257611686, -0.961419205099125064), 1e-13),
        Published("P", 100.0, (0.181513351427031385, -0.983388480334057505), 1e-12),
        Published("P", 2000.0, (-0.814603068589032152, -0.580018827836935462), 1e-11),
    )

    def points(self, q: jax.Array) -> dict[str, jax.Array]:
        return {"P": q}
