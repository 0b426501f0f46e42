"""A02 of the IFToMM library: EXUDYN's published refinement, and singular positions."""

from __future__ import annotations

import re
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers import slope

from bench.plugins.registry import Registry
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from integrators import Steps, Tolerances
from problems.scenes.iftomm import NFourBar

PAGE = Path(__file__).parents[1] / "docs" / "iftomm.md"
#: EXUDYN at rho_inf = 0.95: largest change of energy in J over 10 s by steps in s.
EXUDYN = {1e-3: 1.14e-3, 5e-4: 2.86e-4, 2.5e-4: 7.1e-5, 1.25e-4: 1.8e-5}


def run_of(method: str, scene: NFourBar, t_end: float, h: float = 0.005, rtol: float = 1e-5):
    integrator = Registry().integrator(method)
    resolution = Steps(h) if integrator.controls == "step" else Tolerances(rtol)
    return integrator.prepare(scene, t_end, resolution).measure()


def spread(scene: NFourBar, run) -> np.ndarray:
    """Largest distance in m between the uprights as vectors, at each row."""
    pivots = np.column_stack([np.arange(scene.loops + 1.0), np.zeros(scene.loops + 1)])
    uprights = run.q.reshape(len(run.t), -1, 2) - pivots
    return np.abs(uprights - uprights[:, :1]).max(axis=(1, 2))


def test_the_times_of_the_document_are_of_the_suite_s_methods_and_scenes():
    times = PAGE.read_text("utf-8").partition("## Times")[2].replace("\\", "")
    cells = make_suite(*read_profile("iftomm"), Inventory()).cells.values()
    assert set(re.findall(r"^\| `(.+?)` \|", times, re.MULTILINE)) == {c.integrator for c in cells}
    (head,) = re.findall(r"^\| integrator \| (.*) \|$", times, re.MULTILINE)
    assert head.split(" | ") == [*dict.fromkeys(c.problem for c in cells)]


@pytest.mark.long
def test_the_four_bars_energy_falls_with_order_two_as_exudyns_does():
    scene, changes = NFourBar(), {}
    energy = jax.jit(jax.vmap(scene.energy))
    told = re.findall(r"^\| (\S+) \| (\S+e-\d) \| (\S+e-\d) \|", PAGE.read_text(), re.MULTILINE)
    assert {float(h): float(theirs) for h, theirs, _ in told} == EXUDYN
    for h, theirs, ours in (map(float, row) for row in told):
        run = run_of("generalized_alpha[rho_inf=0.95,newton_tol=1e-5]", scene, 10.0, h)
        assert run.status == "ok", run.message
        values = np.asarray(energy(run.q, run.v))
        changes[h] = np.abs(values - values[0]).max()
        assert theirs / 1.2 < changes[h] < theirs * 1.2
        assert changes[h] == pytest.approx(ours, rel=0.01)
    assert slope([*changes], [*changes.values()]) == pytest.approx(2.0, abs=0.05)


#: The first two singular positions are passed at t = 0.714 and 1.228 s.
def test_singular_positions_are_passed_on_the_same_branch():
    scene = NFourBar(loops=2)
    for method in ("rattle", "energy_momentum", "lobatto_iiia_iiib"):
        run = run_of(method, scene, 1.5)
        assert run.status == "ok", run.message
        assert spread(scene, run).max() < 1e-9
        assert np.abs(run.q - scene.exact(run.t)["q"]).max() < 0.02


@pytest.mark.long
def test_rounding_of_multipliers_stops_newtons_method_close_to_a_singular_position():
    scene, h = NFourBar(), 1.25e-4
    run = run_of("generalized_alpha[rho_inf=0.95]", scene, 10.0, h)
    assert run.status == "newton_failed"
    assert abs(np.arctan2(run.q[-1, 0], run.q[-1, 1]) % np.pi - np.pi / 2) < 10 * h


#: Ends of runs with 40 loops, with the largest distance of uprights in m: some take another branch
#: without a word. With dopri8 rounding, which other processors have otherwise, decides.
FORTY = {
    **dict.fromkeys(("rattle", "energy_momentum", "lobatto_iiia_iiib", "bdf_adaptive",
                     "generalized_alpha", "ida"), ("ok", 0.0, 1e-5)),
    "phem56": ("ok", 1.0, np.inf),
    **dict.fromkeys(("ali3p", "generalized_alpha_adaptive"), ("newton_failed", 0.0, np.inf)),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("method", FORTY)
def test_forty_loops_pass_singular_positions_fail_there_or_take_another_branch(method):
    scene, (status, least, most) = NFourBar(loops=40), FORTY[method]
    run = run_of(method, scene, 10.0)
    assert run.status == status, run.message
    assert least <= spread(scene, run).max() < most
    if status != "ok":
        assert abs(run.q[-1][1]) < 0.1
