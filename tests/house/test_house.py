"""The rules of the house: what is checked of every file, whatever it is about."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions
from pathlib import Path

import pytest
from typer.testing import CliRunner

from missions import cli

ROOT = Path(__file__).parents[2]
PACKAGES = ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions")
GENERIC = ("kb", "rosa_bt", "rosa_pddl")
MISSION_WORDS = (
    "suave",
    "pipeline",
    "thruster",
    "spiral",
    "recharge",
    "battery",
    "bluerov",
    "agv",
    "uav",
)

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def sources(*packages):
    files = [path for package in packages for path in sorted((ROOT / package).rglob("*.py"))]
    assert files, packages
    return files


def written():
    """Return every file of the project that a person wrote: no environment, no cache."""
    files = [path for path in ROOT.rglob("*") if path.is_file()]
    unwritten = {".git", ".venv", "__pycache__", "build", "dist", "node_modules"}
    own = [path for path in files if not unwritten & set(path.relative_to(ROOT).parts)]
    return [
        path
        for path in own
        if not any("cache" in part or part == ".hypothesis" for part in path.parts)
    ]


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["lint-imports"],
    ],
    ids=" ".join,
)
def test_check_passes(command):
    program = Path(sys.executable).with_name(command[0])
    done = subprocess.run(
        [str(program), *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_types_are_strict_of_the_packages_the_examples_and_a_new_robot(tmp_path, monkeypatch):
    """In one go: nearly all of the time is for the packages, which the others import."""
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli.app, ["new", "my_robot", "--task", "both"]).exit_code == 0
    examples = [str(path) for path in (ROOT / "examples").glob("*.py")]
    assert len(examples) >= 11
    test_check_passes(["mypy", *PACKAGES, *examples, str(tmp_path / "my_robot")])


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_listed_sorted_and_there(package):
    module = importlib.import_module(package)
    assert module.__all__ == sorted(module.__all__)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name, None) is not None
    assert module.__doc__


@pytest.mark.parametrize("path", sources(*PACKAGES), ids=lambda path: str(path.relative_to(ROOT)))
def test_every_list_of_public_names_is_sorted(path):
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            names = ast.literal_eval(node.value)
            assert names == sorted(names)


@pytest.mark.parametrize("path", sources(*GENERIC), ids=lambda path: str(path.relative_to(ROOT)))
def test_generic_package_speaks_of_no_mission(path):
    words = set(re.findall(r"[a-z]+", path.read_text().lower()))
    assert not words & set(MISSION_WORDS)


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_typed(package):
    assert (ROOT / package / "py.typed").is_file()


def test_every_pin_is_a_name_and_a_version_only():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert lines
    for line in lines:
        assert re.fullmatch(r"[A-Za-z0-9_.\-]+==[A-Za-z0-9_.!+\-]+", line), line


def normalised(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def declared():
    groups = [
        PROJECT["project"]["dependencies"],
        *PROJECT["project"]["optional-dependencies"].values(),
    ]
    names = [
        normalised(re.match(r"[A-Za-z0-9_.\-]+", text).group())
        for group in groups
        for text in group
    ]
    assert names
    return [
        name for name in names if name != PROJECT["project"]["name"]
    ]  # an extra may be made of others


def test_every_dependency_is_pinned_and_installed_as_pinned():
    pins = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines())
    pinned = {normalised(name): version for name, version in pins.items()}
    installed = {
        normalised(distribution.metadata["Name"]): distribution.version
        for distribution in distributions()
    }
    for name in declared():
        assert name in pinned, f"pin {name} in constraints.txt"
    wrong = {
        name: version for name, version in pinned.items() if installed.get(name, version) != version
    }
    assert not wrong


def test_every_dependency_has_its_reason():
    text = (ROOT / "docs" / "dependencies.md").read_text()
    for name in declared():
        assert re.search(rf"^\| {re.escape(name)} \| .{{15,}} \|$", text, re.MULTILINE), name


def test_nothing_names_a_machine_or_a_registry():
    pattern = re.compile(
        r"/(?:work|root|home|opt(?!/ros/)|tmp)/[a-z.]|\.\./shared|files\.pythonhosted|pypi\.org"
    )
    files = [
        path
        for path in written()
        if path.suffix in {"", ".md", ".py", ".toml", ".txt", ".pddl", ".xml"}
    ]
    assert len(files) > 100
    for path in files:
        if path == Path(__file__):
            continue
        assert not pattern.search(path.read_text(errors="replace")), path


def test_exceptions_to_the_rules_carry_their_reason():
    for path in (*sources(*PACKAGES), *sources("tests")):
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            marker = re.search(
                r"#\s*(?:noqa(?::\s*[A-Z0-9, ]+)?|type:\s*ignore(?:\[[a-z\-, ]+\])?)(.*)$", line
            )
            if marker and path != Path(__file__):
                assert len(marker.group(1).strip(" #")) > 8, f"{path}:{number}: say why"


def test_modules_of_the_late_imports_stay_out_until_they_are_needed():
    heavy = ("mujoco", "unified_planning", "matplotlib")
    code = f"import sys, missions.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
