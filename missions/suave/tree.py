"""The mission as a behaviour tree: find the pipeline, then inspect it.

until inspected
└── search and inspect
    ├── find: pipeline found?, or else search if feasible
    └── inspect if feasible
"""

from py_trees.behaviour import Behaviour
from py_trees.composites import Selector, Sequence

from kb import KnowledgeBase
from missions.engine.mission import Percepts
from missions.suave.actions import InspectPipeline, PipelineFound, SearchPipeline
from rosa_bt import feasible_then_act
from rosa_bt.decorators import UntilSuccess

__all__ = ["search_and_inspect", "suave_tree"]


def suave_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until the whole pipeline is inspected."""
    return UntilSuccess("until inspected", search_and_inspect(kb, percepts))


def search_and_inspect(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the part that does the work; it fails as soon as what it is doing becomes unfeasible."""
    search = feasible_then_act(SearchPipeline(kb, percepts))
    # With memory, a search under way ends by itself, as a success, rather than being cut short by the condition.
    find = Selector("find", memory=True, children=[PipelineFound("pipeline found?", percepts), search])
    inspect = feasible_then_act(InspectPipeline(kb, percepts))
    return Sequence("search and inspect", memory=False, children=[find, inspect])
