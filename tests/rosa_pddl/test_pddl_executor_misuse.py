"""What is handed to an executor and cannot be used, or raises while it runs: clear errors, and nothing left running."""

import pytest
from pddl_world import FakeKb, Task, World
from py_trees.behaviours import Success
from py_trees.common import Status
from py_trees.composites import Sequence

from rosa_pddl import MissingBehaviourError, PddlError, PlanExecutor, UnknownNameError


@pytest.fixture
def world(extended):
    return World(extended)


def happened(world):
    return [(name, what) for _, name, what in world.log]


def make(domain, kb, behaviours):
    return PlanExecutor(
        "plan", kb=kb, domain=domain, behaviours=behaviours, sense=dict, clock=lambda: 0.0
    )


def test_a_missing_behaviour_is_named_at_construction(extended):
    given = dict.fromkeys(["search_pipeline", "inspect_pipelines", "recharge"], Task)
    with pytest.raises(
        MissingBehaviourError, match=r"'inspect_pipeline'.*nearest: inspect_pipelines"
    ):
        make(extended, FakeKb(extended.rosa_actions), given)


def test_an_action_that_the_kb_does_not_know_is_named_at_construction(extended):
    with pytest.raises(PddlError, match="does not know the action 'recharge'"):
        make(
            extended,
            FakeKb(["search_pipeline", "inspect_pipeline"]),
            dict.fromkeys(extended.schemas, Task),
        )


def test_a_behaviour_for_an_action_that_the_domain_does_not_have_is_named_at_construction(extended):
    given = dict.fromkeys([*extended.schemas, "recharg"], Task)
    with pytest.raises(
        UnknownNameError, match=r"'recharg'.*no such PDDL action; nearest: recharge"
    ):
        make(extended, FakeKb(extended.rosa_actions), given)


@pytest.mark.parametrize(
    ("maker", "words"),
    [
        (Success("always the same"), r"'recharge' from .*expected what makes one for each step"),
        (lambda: None, r"'recharge' takes \(\), expected one argument: the step"),
    ],
)
def test_what_is_no_maker_of_behaviours_is_named_at_construction(extended, maker, words):
    given = {**dict.fromkeys(extended.schemas, Success), "recharge": maker}
    with pytest.raises(MissingBehaviourError, match=words):
        make(extended, FakeKb(extended.rosa_actions), given)


# ------------------------------------------------------------------ what is handed in and raises


def failing(world, behaviour, kind):
    """Let what makes the behaviour of the second step do something wrong."""
    world.executor._factories["inspect_pipeline"] = behaviour
    world.run(until="search_pipeline")
    with pytest.raises(kind) as caught:
        world.run()
    assert happened(world) == [("search_pipeline", "begins"), ("search_pipeline", "SUCCESS")]
    assert (world.executor.current_steps, world.executor.children) == ((), [])
    return caught.value


def test_what_a_maker_of_behaviours_raises_comes_out_as_it_is_with_the_step(world):
    error = failing(world, lambda step: {}["camera"], KeyError)
    assert error.__notes__ == [
        "it was raised when the behaviour of inspect_pipeline(inspect_pipeline, pipeline, bluerov) was made"
    ]


def test_what_makes_no_behaviour_is_named_with_the_step(world):
    error = failing(world, lambda step: None, MissingBehaviourError)
    assert "for inspect_pipeline(inspect_pipeline, pipeline, bluerov)" in str(error)
    assert "'inspect_pipeline' made None, expected a py_trees behaviour" in str(error)


def test_what_was_set_up_is_shut_down_when_the_setup_of_another_node_raises(world):
    let_go = []

    class Odd(Task):
        def setup(self, **kwargs):
            raise OSError("no camera")

        def shutdown(self):
            let_go.append(self.name)
            raise RuntimeError("nor that")

    class Even(Task):
        def shutdown(self):
            let_go.append(self.step.schema)

    def both(step):
        return Sequence("two", memory=True, children=[Even(step, world), Odd(step, world)])

    failing(world, both, OSError)
    assert sorted(let_go) == [
        "inspect_pipeline",
        "inspect_pipeline(inspect_pipeline, pipeline, bluerov)",
    ]


def test_what_sense_raises_comes_out_as_it_is_and_nothing_runs_on(world):
    world.run(until="search_pipeline")
    world.executor._belief._sense = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError) as caught:
        world.tick()
    assert caught.value.__notes__ == [
        "this came of what `sense`, or `facts` of a mission, returned or raised"
    ]
    assert happened(world)[-1] == ("search_pipeline", "INVALID")
    assert not world.executor.current_steps


def test_a_behaviour_that_raises_when_it_is_shut_down_keeps_no_other_from_being_let_go_of(world):
    class Stubborn(Task):
        def shutdown(self):
            raise RuntimeError("no")

    world.executor._factories["search_pipeline"] = lambda step: Stubborn(step, world)
    assert world.run() is Status.SUCCESS
