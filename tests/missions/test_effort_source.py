"""What an author writes: what counts as a statement and as a line, and what belongs to a model or a tree."""

import ast
import importlib
import sys
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.engine.registry import MISSIONS
from missions.experiments.effort_source import Written, code_lines, python_written, typeql_written

PARTS = '''"""Parts that several robots have."""

from kb import Model

WHEELS = ("left", "right")
UNUSED = 3


def wheels(model: Model) -> None:
    """Add the wheels."""
    for wheel in WHEELS:
        model.component(wheel)


def lamp(model: Model) -> None:
    model.component("lamp")
'''

ROBOT = '''"""A robot in a package."""

from kb import Model
from py_trees.behaviour import Behaviour
from py_trees.composites import Sequence

from {package} import parts
from {package}.parts import wheels

SPEEDS = {{  # m/s
    "slow": 0.2,

    "fast": 0.7,  # not on stairs
}}


class Drive(Behaviour):
    def update(self):
        return self.status


class InOrder(Sequence):
    pass


def robot():
    """Build it.

    With wheels and a lamp.
    """
    import math

    model = Model("robot")
    # what moves it
    wheels(model)
    parts.lamp(model)
    for name, speed in SPEEDS.items():
        model.component(
            name,
        ).configuration(f"{{name}}_as", {{"speed": speed}})
    return model


def tree(kb, senses):
    return InOrder("in order", memory=True, children=[Drive("drive")])


nameless = lambda: Model("nameless")
'''


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Return a module of a package that is written to disk."""
    package = "effort_robot"
    folder = tmp_path / package
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "parts.py").write_text(PARTS)
    (folder / "robot.py").write_text(ROBOT.format(package=package))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield importlib.import_module(f"{package}.robot")
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        del sys.modules[name]


def test_model_is_its_function_and_what_it_names_in_the_package(robot):
    own = Written(statements=7, lines=9)  # def, model, wheels, lamp, for, configuration, return
    named = Written(1, 4).plus(Written(3, 3)).plus(Written(1, 1)).plus(Written(2, 2))  # SPEEDS, wheels, WHEELS, lamp
    assert python_written(robot.robot) == own.plus(named)


def test_tree_is_counted_without_the_behaviours_at_its_leaves(robot):
    assert python_written(robot.tree) == Written(statements=4, lines=4)


def test_what_partial_gives_its_arguments_is_counted_as_itself(robot):
    assert python_written(partial(partial(robot.tree, 1), 2)) == python_written(robot.tree)


def test_function_without_a_name_or_source_is_not_counted(robot):
    assert python_written(robot.nameless) is None
    assert python_written(len) is None
    assert python_written(partial(robot.nameless)) is None


def test_function_that_names_itself_is_counted_once(robot, tmp_path):
    (tmp_path / "effort_robot" / "loop.py").write_text("def loop():\n    return loop\n")
    importlib.invalidate_caches()
    assert python_written(importlib.import_module("effort_robot.loop").loop) == Written(2, 2)


def test_local_name_is_not_taken_for_the_one_outside(robot, tmp_path):
    text = "def wheel():\n    return 1\n\n\ndef build(lamp):\n    wheel = 2\n    return wheel, lamp\n"
    (tmp_path / "effort_robot" / "local.py").write_text(f"{text}\n\ndef lamp():\n    return 3\n")
    importlib.invalidate_caches()
    assert python_written(importlib.import_module("effort_robot.local").build) == Written(3, 3)


@pytest.mark.parametrize("name", MISSIONS)
def test_every_mission_of_the_registry_has_a_source(name):
    mission = MISSIONS[name]
    for build in (mission.model, mission.tree):
        written = python_written(build)
        assert written is not None
        assert 0 < written.statements <= written.lines


def test_extended_model_is_counted_with_the_one_it_extends():
    base, extended = (python_written(MISSIONS[name].model) for name in ("suave", "suave_extended"))
    assert extended.statements > base.statements
    assert extended.lines > base.lines


@pytest.mark.parametrize(
    "rewrite", [lambda text: ast.unparse(ast.parse(text)), lambda text: text.replace("\n", "\n\n")]
)
def test_layout_changes_no_number_of_statements(robot, tmp_path, rewrite):
    before = python_written(robot.robot)
    for file in (tmp_path / "effort_robot").glob("*.py"):
        file.write_text(rewrite(file.read_text()))
    for name in ("effort_robot.parts", "effort_robot.robot"):
        del sys.modules[name]
    importlib.invalidate_caches()
    again = importlib.import_module("effort_robot.robot")
    assert python_written(again.robot).statements == before.statements


@given(
    st.lists(st.sampled_from(["$a isa Action;", "# $b isa; Action;", "", "  ", "$c has name '#;';", '$d has n ";";']))
)
def test_typeql_statements_end_with_semicolons_outside_of_texts_and_comments(lines):
    told = sum(line.startswith("$") for line in lines)
    assert typeql_written("\n".join(lines)) == Written(told, told)


@given(st.lists(st.sampled_from(["(define", "", "\t", "  ; a comment", ")"])))
def test_lines_are_counted_without_blank_ones_and_comments(lines):
    assert code_lines("\n".join(lines), ";") == lines.count("(define") + lines.count(")")
