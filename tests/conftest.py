"""Settings of every test: the same examples of hypothesis each time, and no clock that decides."""

import os

from hypothesis import settings

from kb import KnowledgeBase
from rosa_pddl import Planner

settings.register_profile("ci", derandomize=True, deadline=None, max_examples=50, print_blob=True)
settings.register_profile("long", derandomize=True, deadline=None, max_examples=1000, print_blob=True)
settings.load_profile("ci")

PATIENCE_S = 120.0
"""How long a test waits for what must come; a busy machine is no failure."""

# so much wall-clock time is given by default where a product's default would have a slow machine decide
Planner.__init__.__defaults__ = ("fast-downward-opt", PATIENCE_S)
KnowledgeBase.query.__defaults__ = (PATIENCE_S,)

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # what hundreds of programs of the tests import is compiled once
