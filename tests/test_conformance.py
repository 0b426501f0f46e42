"""The conformance kit: right plugins pass, and its checks find every planted fault."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import long

from bench.conformance import orders
from bench.conformance.checker import CHECKS, Checker, examine
from bench.conformance.verdicts import FAILED, NOT_APPLICABLE, PASSED, Failed
from bench.guard import limits
from bench.plugins.registry import Registry
from bench.running.inventory import Inventory
from integrators.native.kernel import Kernel

PLUGINS = Path(__file__).parent / "wrong_plugins.py"


@pytest.fixture(scope="module")
def registry():
    return Registry([PLUGINS])


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        *long(("problems", "spring_mass")),
        ("problems", "pendulum[th0=2.0]"),
        *long(("integrators", "newmark")),
        *long(("integrators", "generalized_alpha[rho_inf=0.5]"), ("integrators", "kvaerno5")),
        *long(("integrators", "semi_implicit_euler"), ("integrators", "ida")),
        *long(("integrators", "wrong")),
    ],
)
def test_what_is_right_passes_every_check(registry, kind, text):
    findings = [examine(registry, kind, text, check) for check in CHECKS[kind]]
    assert [finding for finding in findings if finding.verdict == FAILED] == []
    assert sum(finding.verdict == PASSED for finding in findings) >= 8


@pytest.mark.parametrize(
    ("text", "check", "sentence"),
    [
        ("wrong[how=picky]", "scenes", "It takes no scene; refuses andrews, "),
        *long(("wrong[how=order]", "order", "claims order 2 in q on forced_oscillator, is 1.05")),
        ("wrong[how=unchanging]", "pattern", "It counts 50 steps where the step pattern has 100"),
        ("wrong[how=evenly]", "pattern", "ends as steps of 0.05 s do, to the last bit"),
        ("wrong[how=random]", "repeats", "Two runs on forced_oscillator differ in q"),
        ("wrong[how=off_grid]", "rows", "is no multiple of the step"),
        ("wrong[how=late]", "rows", "the last at 5.0, to the last digit"),
        ("wrong[how=without_start]", "rows", "The first row of q on forced_oscillator"),
        ("wrong[how=uncounted]", "work", "steps on forced_oscillator: None at h=0.1 s, None at"),
        ("wrong[how=steps_alone]", "work", "residuals on forced_oscillator: None at h=0.1 s, None"),
        ("wrong[how=always_seven]", "work", "residuals on forced_oscillator: 7 at h=0.1 s, 7 at"),
        ("wrong[how=twice]", "work", "100 steps are counted on forced_oscillator, 50 were asked"),
        ("wrong[how=stateful]", "execute", "measure() before and after execute()"),
        ("wrong[how=idle]", "execute", "but execute() does not return this value"),
        ("wrong[how=from_zero]", "start time", "moved by 64 s q ends 0."),
        ("wrong[how=late]", "samples", "No row on sampled_pd is at the sample t=0.1 s"),
        ("wrong[how=jittery]", "events", "At an impact the height of a ball is "),
        ("wrong[how=heavy]", "events", "Times of impact of a ball are off by 0.00"),
        ("wrong[how=raises]", "nan", "raises FloatingPointError: not finite (wrong_plugins.py"),
        ("wrong[how=raises]", "blow-up", "raises FloatingPointError"),
        ("wrong[how=says_ok]", "nan", "ends with the status 'ok'"),
        ("wrong[how=speechless]", "nan", "the message 'It went wrong.'; name the time"),
        ("wrong[how=divides]", "empty interval", "raises ZeroDivisionError"),
        ("deaf", "tolerance", "Errors in q on forced_oscillator are 1."),
        ("deaf", "work", "steps on forced_oscillator: 50 at rtol=0.0001, 50 at rtol=1e-06"),
        ("forgetful", "options", "forgetful[damping=1.0] is made with damping=0.9"),
        ("nameless", "options", "'nameless' makes another object"),
    ],
)
def test_a_wrong_integrator_is_told_what_to_mend(registry, text, check, sentence):
    finding = examine(registry, "integrators", text, check)
    assert finding.verdict == FAILED
    assert sentence in finding.text


@pytest.mark.parametrize(
    ("name", "check", "sentence"),
    [
        ("wrong_energy", "energy", "W; let the energy fit the forces"),
        ("wrong_momentum", "momentum", "let the momentum fit the forces"),
        ("lopsided_mass", "mass", "M[0,1]=0.1, M[1,0]=0"),
        ("twice_held", "mass", "is singular at the start"),
        ("wrong_exact", "reference", "its a differs from a of the equations of motion"),
        ("wrong_exact", "constraints", "at acceleration level by"),
        ("longer", "constraints", "at position level by"),
        ("skidding", "move", "let move(q, w) follow dq/ds = kinematics(q, w)"),
        ("off_the_rod", "start", "violates the constraints at position level"),
        ("numpy_force", "blocks", "force cannot be traced by JAX: TracerArrayConversionError"),
        ("moody_force", "blocks", "force gives other values when called again"),
        ("hidden_slope", "blocks", "force[1] by v[1] is 0, the difference quotient -1"),
        ("stubborn", "traced", "A traced value of k does not act as a plain one"),
        ("nan_sample", "jumps", "sample() returns demand=nan at t=0 s"),
        ("long_sample", "jumps", "expected finite numbers of shape ()"),
        ("scalar_events", "jumps", "events has shape ()"),
        ("nan_events", "jumps", "events is [nan] at the start"),
        ("misspelt_jump", "jumps", "jump() returns 'velocity', which is no held value"),
        ("idle", "traced", "The parameter c changes nothing"),
        ("idle", "description", "The parameter c has no unit"),
    ],
)
def test_a_wrong_scene_is_told_what_to_mend(registry, name, check, sentence):
    finding = examine(registry, "problems", name, check)
    assert finding.verdict == FAILED
    assert sentence in finding.text
    assert "\n" not in finding.text


@pytest.mark.parametrize("command", [("solve", "pendulum"), *long((("stability",),))])
@pytest.mark.usefixtures("without_processes")
def test_a_run_tells_that_a_step_pattern_is_ignored(refused, tmp_path, command):
    method = "wrong[how=unchanging]"
    step = ("--step", "0.01", "--t-end", "0.45") if command[0] == "solve" else ("--out", tmp_path)
    given = (*command, method, *step, "--pattern", "0.3,0.7", "--plugins", PLUGINS)
    assert "it ignores resolution.pattern" in refused(*given)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda lane, call: 1e-6, "from its twin by 0, from its single run by "),
        *long((lambda lane, call: 1e-6 * lane, "differs from its twin by ")),
        *long((lambda lane, call: 1e-12 * call, "has other bits when it is run again")),
    ],
)
def test_a_batch_that_is_not_its_single_runs_fails(registry, monkeypatch, spoil, sentence):
    plain, calls = Kernel.batched, []

    def spoilt(self, packed, rows, row_count):
        table, end = plain(self, packed, rows, row_count)
        calls.append(1)
        table = np.array(table)  # rows: number, t, q ...
        table[:, :, 2] *= 1 + spoil(np.arange(len(table))[:, None], len(calls))
        return table, end

    monkeypatch.setattr(Kernel, "batched", spoilt)
    finding = examine(registry, "integrators", "stormer_verlet", "batch")
    assert finding.verdict == FAILED
    assert sentence in finding.text


def test_a_check_without_an_object_says_why(registry):
    findings = [
        examine(registry, "integrators", "newmark", "tolerance"),
        examine(registry, "integrators", "ida", "order"),
        examine(registry, "integrators", "ida", "batch"),
        examine(registry, "problems", "spring_mass", "energy"),
    ]
    assert {finding.verdict for finding in findings} == {NOT_APPLICABLE}
    words = (
        "fixed steps",
        "cannot take constant steps",
        "are not JAX functions",
        "states no energy",
    )
    for finding, reason in zip(findings, words, strict=True):
        assert reason in finding.text


@pytest.mark.parametrize(
    ("how", "budget", "sentence"),
    [*long(("hangs", 2.0, "It did not end within 2 s")), ("exits", 60.0, "The process died")],
)
def test_a_check_that_hangs_or_dies_fails_and_the_next_one_goes_on(
    monkeypatch, how, budget, sentence
):
    monkeypatch.setattr(limits, "_LEAST_IDLE", 3.0)
    few = {name: CHECKS["integrators"][name] for name in ("repeats", "options")}
    monkeypatch.setitem(CHECKS, "integrators", few)
    with Checker(Inventory([PLUGINS]), budget) as checker:
        repeats, options = checker.check("integrators", f"wrong[how={how}]")
    assert repeats.verdict == FAILED
    assert sentence in repeats.text
    assert options.verdict == PASSED


def test_a_fault_is_told_once(tmp_path, monkeypatch):
    few = {name: CHECKS["problems"][name] for name in ("description", "start", "blocks")}
    monkeypatch.setitem(CHECKS, "problems", few)
    file = tmp_path / "short.py"
    file.write_text(
        "import numpy as np\nfrom problems import MechatronicSystem, State\n"
        "class Short(MechatronicSystem):\n    'A scene.'\n"
        "    def mass(self, q): return np.eye(4)\n    def force(self, q, v, t): return -q\n"
        "    def initial_state(self): return State(q=np.zeros(4), v=np.zeros(3))\n"
    )
    with Checker(Inventory([file]), 60.0) as checker:
        first, *others = (found.text for found in checker.check("problems", "short"))
    assert first == (
        "v = dq/dt of initial_state() is an array of float64 of shape (3,), expected real numbers "
        "of shape (4,)."
    )
    assert others == ["See description: the same fault."] * 2


@pytest.mark.long
def test_the_command_says_a_line_for_each_check_and_exits_with_1(stepbench, tmp_path):
    file = tmp_path / "heavy.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from problems import parameter\nfrom problems.scenes.pendulum import Pendulum\n"
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


@pytest.mark.long
def test_the_command_answers_in_json(stepbench):
    result = stepbench("check", "spring_mass", "--json")
    assert result.exit_code == 0, result.output
    (answer,) = json.loads(result.stdout)
    assert (answer["name"], answer["kind"], answer["passed"]) == ("spring_mass", "scene", True)
    assert [check["check"] for check in answer["checks"]] == list(CHECKS["problems"])


def test_a_file_that_cannot_be_loaded_fails_with_its_reason(stepbench, tmp_path):
    file = tmp_path / "broken.py"
    file.write_text("import no_such_package\n")
    result = stepbench("check", file)
    assert result.exit_code == 1
    assert "✗ loads: It is unavailable: ModuleNotFoundError" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "Nothing is named; give names or Python files, or --all."),
        (["pendulun"], "did you mean 'pendulum'?"),
        (["newmark[bet=1]"], "newmark has no option 'bet'; did you mean 'beta'?"),
        (["no_such_file.py"], "There is no plugin file or folder"),
    ],
)
def test_a_name_that_is_not_known_is_one_sentence(refused, arguments, words):
    assert words in refused("check", *arguments)


@pytest.mark.parametrize(("count", "rest"), [(2, ""), (40, "; and 37 more like these")])
def test_a_sentence_on_false_orders_is_whole(count, rest, monkeypatch):
    claim = "claims order 2 in lam on double_pendulum_controlled, is 1.05 (h = 0.1 to 0.01 s)"

    def fails(*_):
        raise Failed(orders._failure([claim] * count))

    monkeypatch.setitem(CHECKS["integrators"], "order", fails)
    found = examine(Registry(), "integrators", "newmark", "order")
    assert found.text.endswith(f"0.01 s){rest}; correct `orders` or the method.")
    assert claim in found.text
    assert "…" not in found.text
