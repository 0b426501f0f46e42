"""Bad inputs, generated over all commands, options and arguments: each ends in one sentence."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Iterator

import click
import pytest
from click.testing import Result
from planted import everything, plant

from bench.commands import terminal
from bench.commands.main import main
from bench.commands.options import PathName
from problems.base.text import clean

#: Arguments for which a command would run. {store} is a folder of results, {odd} of odd things.
RIGHT = {
    "list": "scenes", "check": "pendulum", "new": "integrator mine", "show": "pendulum",
    "solve": "pendulum newmark", "order": "pendulum newmark", "run": "quick", "report": "{store}",
    "compare": "{store} {store}",
    "stability": "newmark", "drift": "pendulum newmark", "atlas": "undamped_index3",
    "realtime": "pendulum newmark", "recommend": "pendulum",
    "recommend methods": "pendulum newmark", "judge": "pendulum {odd}/rows.csv",
    "truth": "pendulum",
    # Parameters that only other arguments take:
    **{f"solve {name}": "pendulum ida" for name in ("rtol", "atol")},
}  # fmt: skip
#: Options that go with the arguments or with the parameter that is wrong.
NEEDED = {
    "realtime": {"rate": "--rate 1000"},
}
#: Not wrong there: these commands tell of a plugin that is of no use.
TOLD = re.compile(
    r"(list|check) plugins (text|binary)|run plugins binary|"
    r"check checked (number|half)|judge method module"
)
ANY = {
    "empty": "", "blank": " \t", "sequences": "\x1b[31mred\x1b]0;title\x07\x9b2J\rover",
    "direction": "\u202ependulum\u2066", "long": "x" * 10_000, "words": "no such thing " * 1000,
    "lines": "line\n" * 1000, "not UTF-8": os.fsdecode(b"\xff\xfe"),
    "deep": "newmark" + "[" * 10_000, "half": "newmark[beta=",
    "twice": "newmark[beta=0.25,beta=0.25]", "key": "newmark[=1]", "number": "newmark[beta=nan]",
    "module": "os.system",
}  # fmt: skip
REAL = ANY | {
    "nan": "nan", "minus": "-1", "huge": "1e400", "-inf": "-inf", "hex": "0x1", "unit": "1s"
}  # fmt: skip
WHOLE = REAL | {"digits": "9" * 5000, "many": "9" * 30, "half": "1.5", "zero": "-0.0"}
LIST = ANY | {"nans": "0.1,nan,0.2", "gap": "0.1,,0.2", "comma": ",", "minus": "-0.1,-0.2,0.3"}
PLACE = {
    "pipe": "{odd}/pipe", "socket": "{odd}/socket", "null device": "/dev/null",
    "full device": "/dev/full", "below a file": "{odd}/file.txt/below", "long": "x" * 10_000,
    "deep": "x/" * 5_000, "circle": "{odd}/circle", "empty": "",
    "blank": "  ",
}  # fmt: skip
PLUGIN = PLACE | {"text": "{odd}/file.txt", "none": "{odd}/none", "binary": "{odd}/bits.py"}


def wrong_values(parameter: click.Parameter) -> dict[str, str]:
    """What is wrong for a parameter, each with a word for it."""
    kind = parameter.type
    if getattr(parameter, "is_flag", False):
        return {"value": "yes"}
    if isinstance(kind, PathName):
        return PLACE | (
            {"file": "{odd}/file.txt"} if kind.kind == "folder" else {"folder": "{odd}"}
        )
    if parameter.name == "plugins":
        return PLUGIN
    if isinstance(kind, click.types.IntParamType):
        return WHOLE
    if isinstance(kind, click.types.FloatParamType):
        return REAL
    return LIST if parameter.name in ("steps", "pattern", "at", "rtols") else ANY


def wrong_lines() -> Iterator[tuple[str, list[str]]]:
    """Command lines with one wrong value each, and names for them."""
    for command, described in main.commands.items():
        arguments = [p.name for p in described.params if isinstance(p, click.Argument)]
        for parameter in described.params:
            needed = NEEDED.get(f"{command} {parameter.name}", NEEDED.get(command, {}))
            others = " ".join(two for name, two in needed.items() if name != parameter.name).split()
            for word, value in wrong_values(parameter).items():
                options = others
                given = RIGHT.get(f"{command} {parameter.name}", RIGHT[command]).split()
                if parameter.name in arguments:
                    given[arguments.index(parameter.name)] = value
                elif getattr(parameter, "is_flag", False):
                    options = [*others, f"{parameter.opts[-1]}={value}"]
                else:
                    options = [*others, parameter.opts[-1], value]
                name = f"{command} {parameter.name} {word}"
                if not TOLD.fullmatch(name):
                    yield name, [command, *options, "--", *given]


LINES = dict(wrong_lines())


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> dict[str, str]:
    """A folder of results, and one of odd things."""
    folder = tmp_path_factory.mktemp("places")
    odd = folder / "odd"
    (odd / "none").mkdir(parents=True)
    os.mkfifo(odd / "pipe")
    (odd / "circle").symlink_to("circle")
    (odd / "file.txt").write_text("text")
    (odd / "rows.csv").write_text(
        "# step=1\nt,q1,q2\n0.35,0.82884336436844,-0.55948072115347\n1.35,0.5,-0.8\n"
    )
    (odd / "bits.py").write_bytes(bytes(range(256)))
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(odd / "socket"))
    plant(folder / "store", everything()[:5])
    return {"odd": str(odd), "store": str(folder / "store")}


def assert_refused(result: Result) -> str:
    """Return the sentence: the only thing that was printed, short and of visible characters."""
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code in (1, 2), result.output
    assert "Traceback" not in result.output
    assert result.stdout == ""
    assert clean(result.stderr) == result.stderr
    usage, *sentences = re.split("^Error: ", result.stderr, flags=re.M)
    (sentence,) = sentences
    assert re.fullmatch(r"(Usage: .*\nTry '.*' for help.\n\n)?", usage)
    assert (len(usage) < 300, 10 < len(sentence) < 700) == (True, True)
    assert re.search(r"[.?)]\n$", sentence), sentence
    return sentence


#: Commands that start a process for most of their values.
COSTLY = ("solve", "stability", "judge", "truth")


@pytest.mark.parametrize("all_of_them", [False, pytest.param(True, marks=pytest.mark.attack)])
def test_a_wrong_value_is_refused_in_a_sentence(
    stepbench, places, tmp_path, monkeypatch, all_of_them, request
):
    """`make test` takes every tenth line, of costly commands a third of it, and no process."""
    if not all_of_them:
        request.getfixturevalue("without_processes")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(terminal, "_LINE_EVERY_SECONDS", 1e6)  # of a busy machine
    for number, (name, line) in enumerate(LINES.items()):
        if all_of_them or number % (30 if line[0] in COSTLY else 10) == 0:
            given = [part.format(**places) if "{" in part else part for part in line]
            assert_refused(stepbench(*given))
            assert list(tmp_path.iterdir()) == [], name


def test_every_command_is_attacked():
    assert {name.partition(" ")[0] for name in RIGHT} == set(main.commands)
    assert len(LINES) > 1000


def suite(study: str = "", top: str = "") -> str:
    """A profile that is right but for a line at its top, or of its study."""
    return f"{top}\n[[study]]\nproblems = ['pendulum']\nintegrators = ['newmark']\n{study}\n"


MANY = ", ".join(f"o{k} = ['1', '2', '3']" for k in range(60))
PROFILES = {
    "binary": "\udcff\udcfe\0", "null": "a = '\0'", "sequences": "title = '\x1b[31m'",
    "no table": "study = 1", "stepps": "stepps = 1", "problem": "[[study]]\nproblem = ['pendulum']",
    "no list": "[[study]]\nproblems = ['pendulum']\nintegrators = 3", "open": "study = [",
    "no study": "study = []", "table": "[study]\nproblems = ['pendulum']",
    "numbers": "study = [1, 2]", "no integrators": "[[study]]\nproblems = ['pendulum']",
    "no scene": "[[study]]\nproblems = []\nintegrators = []",
    "scene": "[[study]]\nproblems = ['pendulum[']\nintegrators = ['newmark']",
    "method": "[[study]]\nproblems = ['pendulum']\nintegrators = ['\\u202enewmark']",
    "nan": suite(top="budget_s = nan"), "inf": suite(top="budget_s = inf"),
    "budget": suite(top="budget_s = -1"), "memory": suite(top="memory_gib = inf"),
    "samples": suite(top="samples = -1"), "text": suite(top="samples = 'many'"),
    "atlas": suite(top="atlas = ['nothing']"), "step": suite("steps = [9]"),
    "step zero": suite("steps = [0.0]"), "end": suite("t_end = inf"),
    "tolerance": suite("rtol = [-1.0]"), "pattern": suite("pattern = [0.5, nan]"),
    "misspelt figure": suite("figures = ['convergance']"),
    "unknown key": suite("problem = 'pendulum'"),
    "vary key": suite("vary = {strat = ['1']}"), "vary value": suite("vary = {start = ['late']}"),
    "vary nothing": suite("vary = {beta = []}"), "vary all": suite(f"vary = {{{MANY}}}"),
    **{f"component {c}": suite(f"components = ['{c}']") for c in ("q3", "q2:q9", "q1:", "z1")},
}  # fmt: skip

#: Words of the sentence on some of them.
WORDS = {
    **dict.fromkeys(("no table", "numbers", "table"), "not as expected"),
    **dict.fromkeys(("no list", "no integrators"), "integrators"),
    "stepps": "unknown field `stepps`", "problem": "unknown field `problem`",
    "samples": "samples=-1 is not allowed; give 0 (no timing) to 1000",
    "open": "not valid TOML", "no study": "Nothing is left to run",
    "budget": "budget_s=-1", "step zero": "positive number", "step": "larger than",
    "tolerance": "rtol=-1", "misspelt figure": "did you mean 'convergence'",
    "vary key": "did you mean 'start'", "vary value": "start=late is not allowed",
    "component q3": "pendulum has no component 'q3'",
    "component q2:q9": "pendulum has no component 'q9'",
    "component q1:": "pendulum has no component ''",
    "component z1": "give a group and a number such as q1",
}  # fmt: skip


def test_a_wrong_profile_is_refused_in_a_sentence(stepbench, tmp_path):
    file = tmp_path / "profile.toml"
    for name, text in PROFILES.items():
        file.write_bytes(text.encode("utf-8", "surrogateescape"))
        sentence = assert_refused(stepbench("run", file, "--out", tmp_path / "out"))
        assert WORDS.get(name, "") in sentence, name
        assert list(tmp_path.iterdir()) == [file], name


def test_an_odd_thing_in_the_place_of_a_profile_is_not_waited_for(stepbench, tmp_path):
    odd = {kind: tmp_path / f"{kind}.toml" for kind in ("pipe", "circle", "missing", "device")}
    os.mkfifo(odd["pipe"])
    odd["circle"].symlink_to(odd["circle"])
    odd["device"].symlink_to("/dev/zero")
    for file in (tmp_path, *odd.values()):
        assert str(file) in assert_refused(stepbench("run", file, "--out", tmp_path / "out"))
        assert not (tmp_path / "out").exists()


def test_a_wrong_command_is_refused_in_a_sentence(stepbench):
    for line in ["lits", "--nothing", "x" * 10_000, "\x1b[2J", ""]:
        assert_refused(stepbench(line))
    assert len(stepbench().stdout.splitlines()) == 9
