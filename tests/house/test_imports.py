"""What each package may import: what is not on its list is denied.

Directions between packages are import-linter's.
"""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ALLOWED = {
    "kb": {"kb", "lark", "ortools", "owlready2", "rdflib"},
    "rosa_bt": {"rosa_bt", "kb", "py_trees", "lark"},
    "rosa_pddl": {"rosa_pddl", "kb", "kairos", "py_trees", "unified_planning"},
    "suave_env": {"suave_env", "mujoco", "numpy", "gymnasium"},
    "missions": {
        "missions",
        "kb",
        "rosa_bt",
        "rosa_pddl",
        "suave_env",
        "py_trees",
        "numpy",
        "matplotlib",
        "markdown_it",
        "rich",
        "typer",
        "scipy",
        "dask",
        "distributed",
        "gymnasium",
        "mujoco",
        "owlready2",
        "pytest",
        "mcap",
        "mcp",
        "msgpack",
        "rclpy",
        "rosbags",
        "rosidl_runtime_py",
        "textual",
        "websockets",
        "zmq",
    },
}
LATE = {
    "unified_planning",
    "suave_env",
    "matplotlib",
    "lark",
    "ortools",
    "owlready2",
    "rdflib",
    "scipy",
    "dask",
    "distributed",
    "gymnasium",
    "pytest",
    "mcap",
    "mcp",
    "msgpack",
    "rclpy",
    "rosbags",
    "rosidl_runtime_py",
    "textual",
    "websockets",
    "zmq",
}
"""Slow to import: only inside functions, or in the one module that is itself imported late."""
LATE_MODULES = {
    "kb/typeql.py",
    "missions/views/picture.py",
    "missions/views/terminal.py",
    "missions/testing/plugin.py",
    "suave_env/gym.py",
}


@cache
def imports(path):
    """Return the top-level package of each import, and whether it is imported at once."""
    tree = ast.parse(path.read_text())
    found = []
    at_import = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports in full"
            names = [node.module]
        else:
            continue
        for name in names:
            found.append((name.split(".")[0], id(node) in at_import))
    return found


@pytest.mark.parametrize("package", ALLOWED)
def test_package_imports_only_what_is_allowed(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        for name, _ in imports(path):
            assert name in ALLOWED[package] or name in sys.stdlib_module_names, (
                f"{path} imports {name}"
            )


@pytest.mark.parametrize("package", ALLOWED)
def test_what_is_slow_to_import_is_imported_late(package):
    for path in sorted((ROOT / package).rglob("*.py")):
        where = str(path.relative_to(ROOT))
        slow = {name for name, at_import in imports(path) if at_import} & LATE - {package}
        assert not slow or where in LATE_MODULES, f"{where} imports {slow} when it is imported"
