"""Right plugins pass every check, and the checks find every planted fault."""

from pathlib import Path

import numpy as np
import pytest
from helpers import long

from bench.check.checker import CHECKS, examine, run_checks
from bench.check.scenes import alike
from bench.check.verdicts import FAILED, NOT_APPLICABLE, PASSED
from bench.plugins.registry import Registry
from bench.running import process as limits
from bench.running.inventory import Inventory
from bench.running.process import NoAnswer
from bench.running.runner import Runner

PLUGINS = Path(__file__).parent / "wrong_plugins.py"


@pytest.fixture(scope="module")
def registry():
    return Registry([PLUGINS])


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("problems", "pendulum[th0=2.0]"),
        *long(("problems", "spring_mass"), ("integrators", "newmark"), ("integrators", "ida")),
        *long(("integrators", "generalized_alpha[rho_inf=0.5]"), ("integrators", "kvaerno5")),
        *long(("integrators", "semi_implicit_euler"), ("integrators", "wrong")),
    ],
)
def test_what_is_right_passes_every_check(registry, kind, text):
    findings = [examine(registry, kind, text, check) for check in CHECKS[kind]]
    assert [finding for finding in findings if finding.verdict == FAILED] == []
    assert sum(finding.verdict == PASSED for finding in findings) >= 5


def told(registry, kind, faults):
    """Faults that are not found, with what is said instead."""
    found = [(fault, examine(registry, kind, *fault[:2])) for fault in faults]
    assert not [f.text for _, f in found if "\n" in f.text]
    return [(fault, f.text) for fault, f in found if f.verdict != FAILED or fault[2] not in f.text]


RUNS = [
    ("wrong[how=random]", "runs", "the second after execute(), differ in q"),
    ("wrong[how=off_grid]", "runs", "is no multiple of the step"),
    ("wrong[how=late]", "runs", "the last at 7.0, to the last digit"),
    ("wrong[how=late_sample]", "runs", "No row on sampled_pd is at the sample t=0.1 s"),
    ("wrong[how=without_start]", "runs", "The first row of q on forced_oscillator"),
    ("wrong[how=uncounted]", "runs", "steps on forced_oscillator: None at h=0.1 s, None at"),
    ("wrong[how=always_seven]", "runs", "residuals on forced_oscillator: 7 at h=0.1 s, 7 at"),
    ("wrong[how=twice]", "runs", "100 steps are counted on forced_oscillator, 50 were asked"),
    ("wrong[how=idle]", "runs", "but execute() does not return this value"),
    ("deaf", "runs", "steps on forced_oscillator: 50 at rtol=0.0001, 50 at rtol=1e-06"),
]
OTHERS = [
    ("wrong[how=picky]", "description", "It takes no scene; refuses andrews, "),
    ("forgetful", "description", "forgetful[damping=1.0] is made with damping=0.9"),
    ("nameless", "description", "'nameless' makes another object"),
    ("wrong[how=heavy]", "events", "Times of impact of a ball are off by 0.00"),
    ("wrong[how=raises]", "endings", "raises FloatingPointError: not finite (wrong_plugins.py"),
    ("wrong[how=explodes]", "endings", "infinite at t=1 s raises FloatingPointError"),
    ("wrong[how=says_ok]", "endings", "ends with the status 'ok'"),
    ("wrong[how=speechless]", "endings", "the message 'It went wrong.'; name the time"),
    ("deaf", "tolerance", "Errors in q on forced_oscillator are 1."),
]
ORDER = [
    ("wrong[how=order]", "order", "claims order 2 in q on forced_oscillator, is 1.01"),
    ("wrong[how=from_zero]", "order", "claims order 2 in q on forced_oscillator, shows none"),
]


@pytest.mark.parametrize("faults", [RUNS, OTHERS, *long(ORDER)], ids=["runs", "others", "order"])
def test_a_wrong_integrator_is_told_what_to_mend(registry, faults):
    assert told(registry, "integrators", faults) == []


def test_a_wrong_scene_is_told_what_to_mend(registry):
    faults = [
        ("wrong_energy", "conserved", "W; let the energy fit the forces"),
        ("wrong_momentum", "conserved", "let the momentum fit the forces"),
        ("lopsided_mass", "start", "M[0,1]=0.1, M[1,0]=0"),
        ("wrong_product", "start", "mass_product differs from mass times a vector by"),
        ("twice_held", "start", "lacks 1 rank at the start"),
        ("wrong_exact", "reference", "a of the equations is off by "),
        ("wrong_slope", "reference", "`exact` is no solution: the slope of q is off by 1 (of 1)"),
        ("skidding", "start", "let move(q, w) follow dq/ds = kinematics(q, w)"),
        ("off_the_rod", "start", "violates the constraints at position level"),
        ("numpy_force", "blocks", "force cannot be traced by JAX: TracerArrayConversionError"),
        ("moody_force", "blocks", "force gives other values when called again"),
        ("hidden_slope", "blocks", "Derivatives of force are not its slope"),
        ("stubborn", "parameters", "A traced value of k does not act as a plain one"),
        ("nan_sample", "start", "at t=0 s: sample()['demand'] is nan, expected finite numbers"),
        ("long_sample", "start", "expected real numbers of shape ()"),
        ("scalar_events", "start", "events has shape ()"),
        ("nan_events", "start", "events is [nan] at the start"),
        ("misspelt_jump", "start", "jump() is 'velocity', expected one of q, v, x"),
        ("idle", "description", "The parameter c has no unit"),
    ]
    assert told(registry, "problems", faults) == []


def test_forces_that_cancel_may_round():
    stiff = np.array([[1e-4], [1e11]])  # a sum of forces of 1e11 N, near balance and beside it
    assert alike(stiff, stiff + 1e-4)
    assert not alike(stiff, stiff + 1e4)
    assert not alike(stiff / 1e11, stiff / 1e11 + 1e-8)


@pytest.mark.parametrize("command", [("solve", "pendulum"), *long((("stability",),))])
@pytest.mark.usefixtures("without_processes")
def test_a_run_tells_that_a_step_pattern_is_ignored(refused, tmp_path, command):
    method = "wrong[how=unchanging]"
    step = ("--step", "0.01", "--t-end", "0.45") if command[0] == "solve" else ("--out", tmp_path)
    given = (*command, method, *step, "--pattern", "0.3,0.7", "--plugins", PLUGINS)
    assert "it ignores resolution.pattern" in refused(*given)


def test_a_check_without_an_object_says_why(registry):
    for kind, name, check, reason in (
        ("integrators", "newmark", "tolerance", "fixed steps"),
        ("integrators", "ida", "order", "cannot take constant steps"),
        ("problems", "spring_mass", "conserved", "states no energy"),
    ):
        found = examine(registry, kind, name, check)
        assert (found.verdict, reason in found.text) == (NOT_APPLICABLE, True), found


CRASHED = "The process died."


def test_a_check_without_an_answer_fails_and_the_next_one_goes_on(monkeypatch):
    name, *names = CHECKS["integrators"]
    answers = NoAnswer("crashed", CRASHED), *names
    monkeypatch.setattr(Runner, "run", lambda self, groups: zip(groups[0], answers, strict=True))
    first, *others = run_checks(Inventory([PLUGINS]), "integrators", "wrong[how=exits]", 60.0)
    assert (first.check, first.verdict, others) == (name, FAILED, names)
    assert first.text == f"{CRASHED} Look for a crash in compiled code or for an exit."


@pytest.mark.long
@pytest.mark.parametrize(("how", "said"), [("hangs", "have it compute"), ("exits", CRASHED[:-1])])
def test_a_check_has_a_process(monkeypatch, how, said):
    monkeypatch.setattr(limits, "STILL_SECONDS", 3.0)
    few = {name: CHECKS["integrators"][name] for name in ("runs", "description")}
    monkeypatch.setitem(CHECKS, "integrators", few)
    runs, description = run_checks(Inventory([PLUGINS]), "integrators", f"wrong[how={how}]", 60.0)
    assert (runs.verdict, description.verdict) == (FAILED, PASSED)
    assert said in runs.text


@pytest.mark.long
def test_the_command_says_a_line_for_each_check_and_exits_with_1(stepbench, tmp_path):
    file = tmp_path / "heavy.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from problems import parameter\nfrom problems.scenes.pendulums import Pendulum\n"
        "@dataclass(frozen=True)\nclass HeavyBob(Pendulum):\n    'A heavy bob.'\n"
        "    m: float = parameter(50.0, '', 'mass')\n"
    )
    result = stepbench("check", "pendulum", file)
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    assert len(lines) == 2 + 2 * len(CHECKS["problems"])
    assert [line for line in lines if "✗" in line] == [
        "  ✗ description: The parameter m has no unit; give '1' for a pure number."
    ]
    assert f"1 of {2 * len(CHECKS['problems'])} checks failed." in result.stderr


def test_a_file_that_cannot_be_loaded_fails_with_its_reason(stepbench, tmp_path):
    file = tmp_path / "broken.py"
    file.write_text("import no_such_package\n")
    result = stepbench("check", file)
    assert result.exit_code == 1
    assert "✗ loads: It is unavailable: ModuleNotFoundError" in result.stdout
