"""Settings of every test: the same examples of hypothesis each time, and no clock that decides."""

import gc
import os

import pytest
from hypothesis import settings

from kb import KnowledgeBase
from rosa_pddl import Planner

settings.register_profile("ci", derandomize=True, deadline=None, max_examples=50, print_blob=True)
settings.register_profile(
    "long", derandomize=True, deadline=None, max_examples=1000, print_blob=True
)
settings.load_profile("ci")

PATIENCE_S = 120.0
"""How long a test waits for what must come; a busy machine is no failure."""

# so much wall-clock time is given by default where a product's default would have a slow machine
# decide
Planner.__init__.__defaults__ = ("fast-downward-opt", PATIENCE_S)
KnowledgeBase.query.__defaults__ = (PATIENCE_S,)

os.environ.pop(
    "PYTHONDONTWRITEBYTECODE", None
)  # what hundreds of programs of the tests import is compiled once


QUICK = (
    *("test_status", "test_knowledge_base", "test_manager", "test_trees"),
    *("test_pddl_executor", "test_runs", "test_faults", "test_replay", "test_imports"),
)
"""The modules of the main things: `pytest -m quick`."""


@pytest.hookimpl(tryfirst=True)
def pytest_itemcollected(item):
    """Mark the tests of the main things."""
    if item.path.stem in QUICK:
        item.add_marker("quick")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Begin with what takes longest, so that no worker is left alone with it at the end."""
    items.sort(key=lambda item: item.path.name != "test_house.py")


def pytest_collection_finish():
    """Have the thousands of tests not gone through whenever Python looks for garbage."""
    gc.collect()
    gc.freeze()
