"""What is written is run: README, documents and examples, in a folder of their own."""

import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import pytest
from typer.testing import CliRunner

from missions import cli
from missions.experiments.campaign import paper_table

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(path):
    """Return (language, text) of every fenced block."""
    return BLOCK.findall(path.read_text())


def run_python(path):
    """Run the Python blocks of a document one after the other.

    A text block after one is what that one prints.
    """
    namespace = {"__name__": "document"}
    found = blocks(path)
    for (language, text), following in zip_longest(found, found[1:], fillvalue=("", "")):
        if language != "python":
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(text, str(path), "exec"), namespace)
        if following[0] == "text":
            assert printed.getvalue() == following[1]


def shell_lines(path):
    """Return the commands of a document as this interpreter's programs."""
    lines = [
        line for language, text in blocks(path) if language == "sh" for line in text.splitlines()
    ]
    return [line.removeprefix("python3 launch.py ") for line in lines if "pytest" not in line]


def drawn(line):
    """Return a command that draws a run without the name of the picture; nothing for any other."""
    found = re.fullmatch(r"rosa (run .*)--plot \S+", line.replace("--no-progress ", ""))
    return found and found[1]


def drawn_before(path):
    """Return the runs that documents before this one draw."""
    before = DOCUMENTS[: DOCUMENTS.index(path)]
    return {drawn(line) for one in before for line in shell_lines(one)} - {None}


def few_runs():
    """The paper's table for one mission and three managers.

    What runs each of them with each is in tests/missions.
    """
    return replace(paper_table(), missions=("suave",), managers=("none", "bt", "ours"))


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_document_does_what_it_says(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("missions.commands.experiments.paper_table", few_runs)
    shutil.copy(ROOT / "tests" / "missions" / "battery_drop.jsonl", tmp_path)
    if path.name not in (
        "tutorial.md",
        "replay_tests.md",
    ):  # parts of files, see below; and of tests, see there
        run_python(path)
    monkeypatch.syspath_prepend(tmp_path)
    said = ""
    for line in shell_lines(path):
        if drawn(line) in drawn_before(path):
            continue
        program, *arguments = line.split()
        if program == "cd":
            monkeypatch.chdir(*arguments)
            monkeypatch.syspath_prepend(Path.cwd())
            continue
        assert program == "rosa", line
        done = CliRunner().invoke(cli.app, arguments)
        assert done.exit_code == 0, f"{line}\n{done.output}\n{done.exception!r}"
        said += done.output
    if path.name == "README.md":
        shown = next(text for language, text in blocks(path) if language == "text")
        assert shown.splitlines()
        assert not set(shown.splitlines()) - set(said.splitlines())
    for name in [
        module for module in sys.modules if module.partition(".")[0] in ("rover", "my_robot")
    ]:
        del sys.modules[name]
    for language, text in blocks(path):
        if language == "json":
            json.loads(text)


def test_tutorial_shows_what_rosa_new_writes_and_what_that_prints(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli.app, ["new", "my_robot", "--task", "both"]).exit_code == 0
    written = [path.read_text() for kind in ("py", "pddl") for path in tmp_path.rglob(f"*.{kind}")]
    tutorial = blocks(ROOT / "docs" / "tutorial.md")
    parts = [text for language, text in tutorial if language in ("python", "pddl")]
    assert len(parts) > 8
    for part in parts:
        assert any(part in text for text in written), part
    command = [sys.executable, "-m", "missions", "run", "my_robot:MISSION"]
    printed = subprocess.run(
        command, cwd=tmp_path / "my_robot", capture_output=True, text=True, check=True
    ).stdout
    (shown,) = (text for language, text in tutorial if language == "text")
    for line in shown.splitlines():
        assert line in printed.splitlines()


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_links_between_documents_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)#:]+)\)", path.read_text()):
        assert (path.parent / target).exists(), target


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_example_prints_what_stands_beside_it(path):
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == path.with_suffix(".txt").read_text()


def test_notebook_prints_what_stands_in_it():
    cells = json.loads((ROOT / "examples" / "notebook.ipynb").read_text())["cells"]
    namespace = {"__name__": "notebook"}
    shown = 0
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        text = "".join(cell["source"])
        last = cell["source"][-1]
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(text, namespace)
        assert printed.getvalue() == "".join(
            text for output in cell["outputs"] for text in output["text"]
        )
        if last.startswith("kb") and "=" not in last:
            shown += "<" in eval(last, namespace)._repr_html_()
    assert shown == 2


def test_ci_runs_exactly_the_test_command_of_the_readme():
    lines = [
        line
        for language, text in blocks(ROOT / "README.md")
        if language == "sh"
        for line in text.splitlines()
    ]
    (command,) = (line for line in lines if "pytest" in line)
    assert command == "python3 launch.py pytest"
    assert command in (ROOT / ".ci" / "run").read_text().splitlines()
