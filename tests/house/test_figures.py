"""How big and how tangled the product may be: the limits of docs/house.md, which only fall."""

import ast
import gc
import io
import re
import sys
import tokenize
from collections import defaultdict
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from threading import Thread

import pytest

from kb import ConfigurationManager, KnowledgeBase
from missions.suave_extended.model import suave_extended_model

ROOT = Path(__file__).parents[2]
PACKAGES = ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions")
LIMITS = {
    name: int(limit.replace(",", ""))
    for name, limit in re.findall(
        r"^ *\| `?([\w ]+?)`? \| ([\d,]+) \|",
        (ROOT / "docs" / "house.md").read_text(),
        re.MULTILINE,
    )
}
"""What docs/house.md allows, by what is counted."""
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
MOST_IN_A_FOLDER = 28  # kb is flat


@cache
def files():
    """Return every file of the product, parsed."""
    return {
        path: ast.parse(path.read_text())
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def dotted(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path, tree, modules):
    """Yield the modules of ours that a file imports, at whatever depth it says so."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                yield submodule if submodule in modules else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def tokens(path):
    """Count what there is to read in a file, however it is broken into lines."""
    text = path.read_text()
    docstrings = set()
    for node in ast.walk(ast.parse(text)):
        is_constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_constant and isinstance(node.value.value, str):
            docstrings.update(range(node.lineno, node.end_lineno + 1))
    return sum(
        token.type not in LAYOUT
        and not (token.type == tokenize.STRING and token.start[0] in docstrings)
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
    )


@pytest.mark.parametrize("folder", [*PACKAGES, "tests"])
def test_folder_keeps_within_its_tokens(folder):
    count = sum(tokens(path) for path in (ROOT / folder).rglob("*.py"))
    assert 0 < count <= LIMITS[folder], "before you add, look what it makes superfluous"


def test_product_keeps_within_its_files():
    assert 0 < len(files()) <= LIMITS["files"]
    assert len([path for path in files() if "kb" in path.parts]) <= LIMITS["files of kb"]


def test_folders_explain_themselves():
    held = defaultdict(list)
    for path in files():
        held[path.parent].append(path.name)
        assert len(path.relative_to(ROOT).parts) <= 3, f"{path}: two levels of folders at most"
    for folder, names in held.items():
        assert len(names) <= MOST_IN_A_FOLDER, folder


def test_no_module_reaches_itself_by_imports():
    modules = {dotted(path) for path in files()}
    graph = {
        dotted(path): {
            module
            for module in imported(path, tree, modules)
            if module in modules and module != dotted(path)
        }
        for path, tree in files().items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_nobody_reaches_into_anothers_underscore_names():
    """`_name` is asked of self, cls, a call's result, and in comparisons of the other."""
    reached = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}"
        for path, tree in files().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and node.attr not in ("_replace", "_asdict")  # public methods of named tuples
        and path.name != "ontology.py"  # owlready2's quick way has no public names
        and not isinstance(node.value, ast.Call)
        and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls", "other"))
    ]
    assert not reached, "\n".join(reached)


def test_knowledge_base_is_one_class_with_few_names():
    assert [one for one in KnowledgeBase.__mro__ if one.__module__.startswith("kb.")] == [
        KnowledgeBase
    ]
    names = [name for name in dir(KnowledgeBase) if not name.startswith("_")]
    assert 0 < len(names) <= LIMITS["public names of KnowledgeBase"], names


def texts(node):
    return {
        ast.unparse(part) for part in ast.walk(node) if isinstance(part, ast.Name | ast.Attribute)
    }


def is_unrelated(assignment):
    """Whether `a, b = x, y` assigns values that do not mention the names: it is two statements."""
    target = assignment.targets[0]
    values = assignment.value
    if not (isinstance(target, ast.Tuple) and isinstance(values, ast.Tuple)):
        return False
    names = {ast.unparse(name) for name in target.elts}
    return not any(names & texts(value) for value in values.elts)


def test_statements_assign_one_value_and_names_say_what_they_hold():
    """Tuples of constants at the top of a module may share a line, and a docstring."""
    wrong = []
    for path, tree in files().items():
        for node in ast.walk(tree):
            is_shared = isinstance(node, ast.Assign) and node not in tree.body
            is_name = isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
            if is_shared and is_unrelated(node):
                wrong.append(f"{path}:{node.lineno}: two statements")
            if is_name and node.id == "one" and path.name != "vehicle.py":  # of six thrusters
                wrong.append(f"{path}:{node.lineno}: one")
    assert not wrong, "\n".join(wrong)


class Managed:
    """A robot that does what it is asked."""

    def activate(self, component): ...

    def deactivate(self, component): ...

    def set_parameters(self, component, parameters): ...


def test_house_page_names_files_that_exist():
    text = (ROOT / "docs" / "house.md").read_text()
    named = re.findall(r"`([a-z_]+/[\w/]+\.\w+)`", text)
    assert named
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_measurement_takes_a_short_way_to_the_parameters_it_changes():
    now = [0.0]
    kb = KnowledgeBase(suave_extended_model(), clock=lambda: now[0])
    manager = ConfigurationManager(kb, Managed())
    kb.measure("water_visibility", 3.5)
    kb.measure("battery_level", 1.0)
    kb.request_action("search_pipeline")
    for _ in range(5):
        now[0] += 0.1
        manager.update()
    called = []
    ours = files()

    def note(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if event == "call" and path in ours:
            called.append(path)

    def measure():
        sys.setprofile(note)
        kb.measure("water_visibility", 3.0)
        manager.update()
        sys.setprofile(None)

    now[0] += 0.1
    gc.disable()  # finalizers of what other tests have dropped are no part of it
    thread = Thread(target=measure)  # one that no other test has traced
    thread.start()
    thread.join()
    gc.enable()
    assert dict(kb.components["spiral_search"].parameters_in_force) == {"spiral_altitude": 2.0}
    assert 0 < len(set(called)) <= LIMITS["files of a measurement"]
    assert sum(one != two for one, two in pairwise(called)) <= LIMITS["hops of a measurement"]


def test_every_public_class_says_what_its_methods_do():
    """Each public method, property and function that a package exports has a docstring."""
    import importlib
    import inspect

    silent = []
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            what = getattr(module, name)
            if not (inspect.isclass(what) or inspect.isfunction(what)):
                continue
            if not inspect.getdoc(what):
                silent.append(f"{package}.{name}")
            if not inspect.isclass(what) or issubclass(what, BaseException | tuple):
                continue
            for method, value in vars(what).items():
                own = inspect.isfunction(value) or isinstance(
                    value, property | classmethod | staticmethod
                )
                if own and not method.startswith("_") and not inspect.getdoc(getattr(what, method)):
                    silent.append(f"{package}.{name}.{method}")
    assert not silent, silent
