"""What a manager is given is checked at once: a slip in a program is no broken robot."""

import pytest
from managed_stand_ins import Scripted, base, rover

from kb import (
    Choice,
    ConfigurationManager,
    InvalidValue,
    KnowledgeBaseError,
    ProtocolError,
    Status,
    UnknownName,
)


class Does:
    def activate(self, component):
        return None

    def deactivate(self, component):
        return None

    def set_parameters(self, component, parameters):
        return None


class TooFew(Does):
    def activate(self):
        return None


def manager_of(**given):
    kb, clock = base(rover())
    return kb, ConfigurationManager(kb, **{"managed": Scripted(clock), **given})


def of(name, method):
    return type("Handed", (), {name: method})()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"managed": object()}, r"a managed system has a method activate\(component\)"),
        ({"managed": TooFew()}, r"is called as activate\(component\); .*TooFew object.*: too many"),
        ({"planner": "by priority"}, r"a planner has a method plan\(kb\); 'by priority' has none"),
        ({"planner": of("plan", lambda self: None)}, r"a planner is called as plan\(kb\)"),
        ({"executor": of("run", lambda self, kb: None)}, r"an executor has a method execute\(kb\)"),
    ],
)
def test_what_cannot_be_called_is_refused_where_it_is_handed_in(given, said):
    with pytest.raises(ProtocolError, match=said) as refused:
        manager_of(**given)
    assert isinstance(refused.value, TypeError | KnowledgeBaseError)


class Answers(Scripted):
    """Answers the activation of a component with whatever it was given."""

    answer = None

    def activate(self, component):
        super().activate(component)
        return self.answer() if callable(self.answer) else self.answer


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (True, r"activate\('camera'\) of Answers returned True; it is to return None"),
    ],
)
def test_wrong_answer_raises_and_fails_no_component(answer, said):
    kb, clock = base(rover())
    managed = Answers(clock)
    managed.answer = answer
    manager = ConfigurationManager(kb, managed)
    kb.request_action("explore")
    for _ in range(4):
        with pytest.raises(ProtocolError, match=said):
            manager.update()
        clock.now += 10.0
    assert kb.components["camera"].status is not Status.FAILURE
    managed.answer = None
    manager.update()
    results = [attempt.result for attempt in kb.history.attempts if attempt.operation == "activate"]
    assert results == [*["abandoned"] * 4, "completed"]
    assert kb.components["camera"].status is Status.SOLVED
    assert [plan.result for plan in kb.plans] == ["completed"]


@pytest.mark.parametrize(
    ("plan", "error", "said"),
    [
        (
            lambda kb: kb.select({"see": "by camera"}),
            InvalidValue,
            "by camera cannot be selected: .* has failed",
        ),
        (
            lambda kb: kb.select({}, {"camera": "day"}),
            InvalidValue,
            "day cannot be selected: .* violates >= 0.5",
        ),
        (lambda kb: kb.select({"see": "day"}), UnknownName, "unknown function design 'day'"),
        (
            lambda kb: Choice({"see": "by lidar"}, {}),
            ProtocolError,
            "returned Choice.* what kb.select returned",
        ),
    ],
)
def test_wrong_choice_raises_and_selects_nothing(plan, error, said):
    kb, manager = manager_of(planner=of("plan", lambda self, kb: plan(kb)))
    kb.measure("light", 0.1)
    kb.component_failed("camera")
    kb.request_action("explore")
    before = kb.log.last
    for _ in range(2):
        with pytest.raises(error, match=said):
            manager.update()
    assert kb.log.last == before


def test_choice_that_became_unfeasible_is_made_again():
    class Overtaken:
        is_first = True

        def plan(self, kb):
            chosen = kb.selectable_designs("see")[0] if kb.adaptable_functions() else None
            if self.is_first:
                kb.component_failed(
                    "camera"
                )  # as another thread may tell it, between the question and the choice
                self.is_first = False
            return kb.select({"see": chosen}) if chosen else None

    kb, manager = manager_of(planner=Overtaken())
    kb.request_action("explore")
    assert manager.update() is None
    assert manager.update().activate == ("lidar",)
