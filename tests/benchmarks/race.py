"""Native methods against C, exudyn and other solvers; families of methods; solvers in C and Python.

``make bench`` prints the tables of docs/performance.md.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations, product
from typing import Any

import frame
from frame import OURS, SCENE, STEPS, Contestant, NotHere, Row, contestant, native_methods, race
from opponents import c_program, exudyn_run, peak
from scipy.stats import spearmanr

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from problems.base.runtime import use_one_thread
from problems.scenes.heavy_top import HeavyTopR3SO3
from problems.scenes.ivp_test_set import CarAxis
from problems.scenes.oscillators import Duffing
from problems.scenes.pendulums import Pendulum
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrankMinimal
from problems.system import MechatronicSystem
from problems.truth.reference import Reference

#: One or two methods of each family; `all_native` adds the other native methods.
MEMBERS = (
    OURS,
    "generalized_alpha[formulation=stabilised_index2,rho_inf=0.8,newton=modified]",
    *(f"{name}[newton=modified]" for name in ("hht_i3", "park", "bdf2", "ali3p")),
    "bdf2[formulation=stabilised_index2,newton=modified]",
    "bathe[formulation=index2,newton=modified]",
    "bathe[formulation=stabilised_index2,newton=modified]",
    *("rattle", "rattle[newton=modified]", "semi_implicit_euler", "linearly_implicit_euler"),
    *("half_explicit_euler", "phem56", "rodas5p", "radau_iia[stages=2,newton=modified]"),
    "radau_iia[formulation=stabilised_index2,newton=modified]",
    *(f"{name}[newton=modified]" for name in ("energy_momentum", "lobatto_iiia_iiib")),
    *(f"{name}[newton=modified]" for name in ("bdf_adaptive", "generalized_alpha_adaptive")),
)
#: Solvers of other kinds, at equal error.
PEERS = ("ida", "kvaerno5", "radau")
#: A scene for methods that take no constraints, and one for those that take rotations alone.
FREE, LIE = Duffing(), HeavyTopR3SO3()
#: Steps of generalized-alpha in the races at equal error.
SIZES = (1e-3, 1e-4)
#: Solvers of libraries, the first of each with equations in C; scenes and tolerance.
SOLVERS = (
    ("ida", "ida[callbacks=python]", "bdf_adaptive"),
    ("cvode", "cvode[callbacks=python]"),
    ("radau", "radau[callbacks=python]"),
)
_IN_C, _RTOL = (SCENE, CarAxis(), SliderCrankMinimal(), QuarterCar()), 1e-6
#: Tolerance of methods without constant steps; pairs that seconds and operations order differently
#: by more than this factor are listed.
_FINE, _APART = 1e-9, 2.0
#: Solutions of the same discrete equations, solved to these tolerances, differ by less.
_SAME = 1e-6


def same_equations(rounds: int) -> list[Row]:
    """Index 3, 20 000 steps: everybody solves the same discrete equations."""
    of = [OURS, f"generalized_alpha[rho_inf={frame.RHO:g}]"]
    makers = [partial(contestant, spec, Steps(frame.T_END / STEPS)) for spec in of]
    makers += [c_program, *(partial(exudyn_run, kind) for kind in ("full", "modified"))]
    rows = race(f"the same {STEPS} steps", makers, rounds)
    for row in rows:
        if not row.get("gap", 0.0) < _SAME:
            raise SystemExit(f"{row['contestant']} ends elsewhere than {OURS}: by {row['gap']:.1e}")
    return rows


def all_native(scene: MechatronicSystem) -> list[str]:
    """Native methods: those that take the slider crank, or the others that take this scene."""
    registry = Registry()
    refused = {name: registry.integrator(name).why_not for name in native_methods()}
    if scene is SCENE:
        members = {one.partition("[")[0] for one in MEMBERS}
        return [*MEMBERS, *(n for n, of in refused.items() if n not in members and not of(SCENE))]
    others = [one for one in (SCENE, FREE) if one is not scene]
    taken = (n for n, of in refused.items() if not of(scene) and all(map(of, others)))
    return [OURS, *taken]


def same_step(members: list[str], scene: MechatronicSystem, steps: int, rounds: int) -> list[Row]:
    """Methods with the same constant steps, or at a tolerance, and the program in C."""
    start, end = scene.interval
    at, reference = Steps((end - start) / steps), Reference(scene, end)

    def made(spec: str) -> Contestant:
        try:
            return frame.at_constant_steps(spec, at, reference, scene)
        except NotHere as reason:
            if "no constant steps" not in str(reason):
                raise
        return contestant(spec, Tolerances(_FINE), reference, scene)

    makers = [*(partial(made, one) for one in members), *([c_program] if scene is SCENE else [])]
    return race(f"{scene.name}, the same step, h={at.h:g} s", makers, rounds)


def costs(row: Row) -> tuple[float, float]:
    """Least seconds and operations of an attempted step."""
    attempts = row["steps"] + (row["work"].get("rejected") or 0)
    return min(row["seconds"]) / attempts, row["operations"] / attempts


def comparison(rows: list[Row]) -> str:
    """The rank correlation (Spearman's) of seconds and operations, and the pairs of which one takes
    fewer operations and more time, by more than a factor of two together."""
    rows = [row for row in rows if row.get("operations")]
    seconds, operations = zip(*map(costs, rows), strict=True)
    found: Any = spearmanr(seconds, operations)[0]
    lines = [f"Rank correlation of seconds and operations: {found:.3f}.", ""]
    for two in combinations(rows, 2):
        few, many = sorted(two, key=lambda row: costs(row)[1])
        (slow, little), (fast, much) = costs(few), costs(many)
        if slow > fast and slow * much > _APART * fast * little:
            lines.append(
                f"- `{few['contestant']}` takes {slow / fast:.1f} times as long as "
                f"`{many['contestant']}`, which takes {much / little:.1f} times as many operations."
            )
    return "\n".join([*lines, ""])


def same_error(racers: list[str], scene: MechatronicSystem, h: float, rounds: int) -> list[Row]:
    """All methods at about the error of generalized-alpha in a; its row is the first."""
    reference = Reference(scene, scene.interval[1])
    ours = contestant(OURS, Steps(h), reference, scene)
    assert ours.error is not None
    others = [one for one in racers if one != OURS]
    makers = [partial(frame.equally_accurate, one, ours.error, reference) for one in others]
    return race(f"{scene.name}, equal error in a, h={h:g} s", [lambda: ours, *makers], rounds)


def beside_python(scene: MechatronicSystem, solvers: tuple[str, ...], rounds: int) -> list[Row]:
    """A library's solver with equations in C, the first, and through Python."""
    reference, at = Reference(scene, scene.interval[1]), Tolerances(_RTOL)
    makers = [partial(contestant, one, at, reference, scene) for one in solvers]
    return race(f"{scene.name}, rtol={_RTOL:g}", makers, rounds)


def main() -> None:
    """Measure, print the tables, write the JSON."""
    given = frame.options(__doc__, 7, "stepbench-race.json")
    most, rows = peak(), []
    if most is not None:
        print("The peak of a core: {:.1f} Gflop/s, {:.1f} by single numbers.".format(*most))

    def show(more: list[Row]) -> None:
        rows.extend(more)
        print(frame.table(more, most and most[0]), flush=True)

    few = max(3, given.rounds // 2)
    show(same_equations(3 * given.rounds))
    for scene in (SCENE, FREE, LIE, Pendulum(), CarAxis(), QuarterCar()):
        more = [one for one in native_methods() if not Registry().integrator(one).why_not(scene)]
        found = same_step([*dict.fromkeys([*all_native(scene), *more])], scene, STEPS, given.rounds)
        show(found)
        print(comparison(found), flush=True)
    for scene, solvers in product(_IN_C, SOLVERS):
        show(beside_python(scene, solvers, given.rounds))
    for scene, h in product((SCENE, FREE, LIE), SIZES):
        peers = PEERS if scene is SCENE else ()
        show(same_error([*all_native(scene), *peers], scene, h, few))
    frame.write(rows, given.out)


if __name__ == "__main__":
    use_one_thread()
    main()
