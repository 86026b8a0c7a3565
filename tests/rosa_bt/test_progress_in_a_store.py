"""A store keeps where an action is, and the next program's tree goes on from there."""

import pytest
from py_trees.common import Status
from xml_leaves import wrapped

from kb import KnowledgeBase, Model
from rosa_bt import BehaviourRegistry, RosaAction, TreeRunner, load_xml

XML = wrapped("<Sequence><count/></Sequence>")


class Count(RosaAction):
    done = None

    def initialise(self):
        self.done = 0

    def update(self):
        self.done += 1
        return Status.SUCCESS if self.done >= 10 else Status.RUNNING

    def save_progress(self):
        return {"done": self.done}

    def restore_progress(self, progress):
        self.done = progress["done"]


class Program:
    """A tree with one action on a knowledge base with a store; a second passes with each tick."""

    def __init__(self, path):
        self.now = 0.0
        model = Model("rover")
        model.action("count")
        self.kb = KnowledgeBase(model, store=path, clock=lambda: self.now)
        registry = BehaviourRegistry(kb=self.kb)
        registry.register("count", lambda: Count("count", self.kb, "count"))
        self.root = load_xml(XML, registry)
        self.runner = self.anew()

    def anew(self):
        return TreeRunner(self.root, clock=lambda: self.now)

    @property
    def count(self):
        return next(one for one in self.root.iterate() if isinstance(one, Count))

    def tick(self, times):
        for _ in range(times):
            self.now += 1.0
            self.runner.tick()
        return self.count.done


@pytest.fixture
def path(tmp_path):
    return tmp_path / "rover.store"


@pytest.mark.parametrize("is_shut_down", [True, False])
def test_next_program_goes_on_where_the_last_ended(path, is_shut_down):
    before = Program(path)
    assert before.tick(4) == 4
    if is_shut_down:
        before.runner.shutdown()
    before.kb.close()
    after = Program(path)
    assert after.tick(1) == 5
    assert after.tick(5) == 10
    assert after.root.status is Status.SUCCESS
    assert after.kb.history.progress == {}
    after.kb.close()
    assert Program(path).tick(1) == 1


def test_new_mission_begins_at_the_beginning(path):
    program = Program(path)
    program.tick(4)
    program.runner.shutdown()
    program.runner = program.anew()
    assert program.tick(1) == 1
    assert program.kb.history.progress == {}
    assert program.tick(1) == 2
    assert program.kb.history.progress == {("count", "count"): '{"done": 2}'}
