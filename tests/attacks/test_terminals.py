"""Terminals, streams and encodings that are odd, and reasons of any length."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable

import click
import pytest
from helpers import long
from planted import everything, plant

from bench.commands.main import ShortErrors
from problems.base.text import LONGEST_LINE, clean, shortened

COMMAND = [sys.executable, "-c", "from bench.commands.main import main; main()"]
HOSTILE = "\x1b[2J\x1b]0;owned\x07 \x9b31m \x08\r \u202eback\u2066 \u200f \x7f \udcff"


def hostile_file(folder, text):
    file = folder / "hostile.py"
    file.write_text(f"TEXT = {json.dumps(HOSTILE)}\n{text}")
    return file


@pytest.mark.parametrize(
    "source",
    [
        "raise ValueError(TEXT * 10_000)",
        *long("raise SyntaxError(TEXT)", "import sys\nsys.exit(TEXT)"),
    ],
)
def test_whatever_a_plugin_raises_is_a_short_reason(stepbench, tmp_path, source):
    result = stepbench("solve", "pendulum", "hostile", "--plugins", hostile_file(tmp_path, source))
    assert (result.exit_code, type(result.exception)) == (1, SystemExit)
    assert result.stderr.startswith("Error: Plugin ")
    assert len(result.stderr) < 1000
    assert clean(result.stderr) == result.stderr


def test_a_message_is_cut_in_its_middle():
    text = shortened("begin " + "x" * 10_000 + " " + "word " * 10_000 + "end")
    assert len(text) == LONGEST_LINE
    assert text.startswith("begin xxx")
    assert "…" in text
    assert text.endswith("word end")
    assert len(shortened("line\n" * 1000).split("\n")) == 20
    assert shortened("a tab\tand\nlines, äß…≤ stay") == "a tab\tand\nlines, äß…≤ stay"


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_a_stream_of_any_encoding_takes_any_text(encoding, monkeypatch):
    streams = [io.TextIOWrapper(io.BytesIO(), encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    group = ShortErrors("group")
    group.command("say")(lambda: [click.echo("✓ … \udcff", err=err) for err in (False, True)])
    with pytest.raises(SystemExit):
        group.main(["say"])
    for stream in streams:
        written = stream.buffer.getvalue().decode(encoding).strip()
        assert written.endswith(r" \udcff")
        assert written.startswith(("✓", r"\u2713"))


# ---- whole commands in processes of their own ---------------------------------------------
@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return plant(tmp_path_factory.mktemp("results"), everything()[:5])


def closed(*numbers: int) -> Callable[[], None]:
    return lambda: [os.close(number) for number in numbers] and None


def ended(arguments: list[str], **more) -> subprocess.CompletedProcess[bytes]:
    known = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "timeout": 500}
    more["env"] = {**more.get("env", os.environ), "PYTHONUNBUFFERED": ""}  # as users have it
    result = subprocess.run([*COMMAND, *arguments], **known | more)
    assert b"Traceback" not in (result.stderr or b"")
    assert b"Exception ignored" not in (result.stderr or b"")
    return result


@pytest.mark.parametrize("kind", ["closed", "full"])
def test_an_answer_that_cannot_be_given_is_no_success(kind):
    with open("/dev/full", "wb") as full:
        more = {"preexec_fn": closed(1)} if kind == "closed" else {"stdout": full}
        result = ended(["list"], **more)
    assert result.returncode == 1
    assert result.stderr.startswith((b"Error: The standard", b"Error: The system refused"))
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.attack
def test_a_reader_that_leaves_early_ends_it_quietly(store):
    for line in (["list", "--json"], ["report", "--csv", str(store)]):
        reader, writer = os.pipe()
        os.close(reader)
        result = ended(line, stdout=writer)
        os.close(writer)
        assert (result.returncode, result.stderr) == (1, b"")
