"""No fault of a managed system makes the manager lie, stall or end a plan twice.

The long part is in the benchmarks.
"""

import pytest
from faulty import Interrupted, Life, interrupted_at, interrupted_turns, lived
from managed_stand_ins import Scripted, base, rover, turn

from kb import ConfigurationManager, Status


@pytest.mark.parametrize("seed", range(10))
def test_no_managed_system_makes_the_manager_lie(seed):
    life = lived(seed, 40 if seed == 5 else 200, faults=0.3, optimal=seed == 5)
    assert len(life.kb.plans) > 3
    assert {plan.result for plan in life.kb.plans} <= {"completed", "failed"}


@pytest.mark.parametrize("seed", range(10))
def test_interrupted_calls_leave_nothing_behind(seed):
    life = lived(seed, 40 if seed == 5 else 200, faults=0.3, interrupts=0.05, optimal=seed == 5)
    assert life.interrupted > 1
    assert any(attempt.result == "abandoned" for attempt in life.kb.history.attempts)


@pytest.mark.parametrize("seed", range(6))
def test_update_interrupted_anywhere_goes_on_correctly(seed):
    steps = [1 + (97 * number * number + 13 * seed) % 4000 for number in range(60)]
    life = interrupted_turns(seed, steps)
    assert life.interrupted > 1


def test_interrupted_plan_begins_with_its_first_stage():
    """At each instruction of the turn that plans and carries out."""
    count = []
    life = Life(0, faults=0.0)
    life.kb.request_action("take")
    interrupted_at(0, life.manager.update, count)
    assert count[0] > 3000
    for step in range(1, count[0], count[0] // 60):
        life = Life(0, faults=0.0)
        life.kb.request_action("take")
        with pytest.raises(Interrupted):
            interrupted_at(step, life.manager.update)
        life.update()
        life.look()
        assert [plan.result for plan in life.kb.plans] == ["completed"], step
        life.rest()


class Impatient(Scripted):
    """Its user presses Ctrl-C in the first call to start the camera."""

    is_interrupted = False

    def activate(self, component):
        if component == "camera" and not self.is_interrupted:
            self.is_interrupted = True
            raise KeyboardInterrupt
        return super().activate(component)


def test_two_open_plans_after_an_interrupt_end_as_they_were():
    kb, clock = base(rover())
    managed = Impatient(clock)
    manager = ConfigurationManager(kb, managed)
    kb.request_action("explore")
    with pytest.raises(KeyboardInterrupt):
        manager.update()
    kb.select({"see": "by lidar"})
    first, second = kb.plans
    turn(manager, clock, 3)
    assert (first.result, second.result) == ("abandoned", "completed")
    started = [attempt for attempt in kb.history.attempts if attempt.operation == "activate"]
    assert [(attempt.plan, attempt.component) for attempt in started] == [
        (first, "camera"),
        (second, "lidar"),
    ]
    assert [attempt.result for attempt in started] == ["abandoned", "completed"]
    assert managed.running == {"lidar"}
    assert kb.actions["explore"].status is Status.SOLVED
    assert len(kb.plans) == 2
