"""Options of managers, and the time that they take: in the sea, and on this machine."""

from itertools import count
from time import perf_counter

import numpy
import pytest

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.baselines import Manager, Setting, open_run
from missions.baselines.policies import Random
from missions.baselines.rosa import CONFIGURING, FETCHING, INSERTING, PLANNING
from missions.engine.mission import MissionError, find_mission, split_settings
from missions.engine.runner import Listener
from missions.views.output import as_json, summary

SUAVE = find_mission("suave")
SWITCHING_S = 0.03
CALLS = {"U1": INSERTING + PLANNING + FETCHING, "U2": INSERTING + PLANNING + FETCHING + CONFIGURING}


def spend(seconds):
    until = perf_counter() + seconds
    while perf_counter() < until:
        pass


class Slow(Manager):
    """Thinks for 0.05 s before it searches, and for as long again after it."""

    options = (Setting("thought_s", 0.05, "s", "how long it thinks", "own choice"),)

    def begin(self, task):
        self.asked_s = self.robot.now
        spend(self.robot.options["thought_s"])
        self.robot.activate("spiral_search")
        self.told_s = self.robot.now
        spend(self.robot.options["thought_s"])


def slow(**arguments):
    run = open_run(SUAVE, manager=f"{__name__}:Slow", settings={"duration_s": "10"}, **arguments)
    run.run()
    (change,) = run.world.history
    return run, change.time - run.robot.tasks[0].start


class Managed:
    def activate(self, component): ...

    def deactivate(self, component): ...

    def set_parameters(self, component, parameters): ...


def test_random_policy_chooses_anew_because_time_has_passed():
    model = Model("rover")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("day", {"rate": 1})
    camera.configuration("night", {"rate": 2})
    model.function("see").design("by_camera", [camera])
    model.action("look", requires=["see"])
    now = [0.0]
    kb = KnowledgeBase(model, clock=lambda: now[0])
    manager = ConfigurationManager(
        kb, Managed(), planner=Random(model, numpy.random.default_rng(0), {"period_s": 1.0})
    )
    kb.request_action("look")
    for _ in range(200):  # nothing is measured meanwhile
        manager.update()
        now[0] += 0.1
    assert {name for plan in kb.plans for name in plan.parameters} == {"day", "night"}
    assert len(kb.plans) > 2


def test_thinking_takes_no_simulated_time():
    _, took_s = slow()
    assert took_s == pytest.approx(SWITCHING_S)


def test_each_reaction_knows_the_compute_time_that_went_into_it_and_time_of_listeners_is_none(
    monkeypatch,
):
    now = count()  # each look at this clock takes a second

    class Idle(Listener):
        def tick(self, run):
            for _ in range(1000):
                next(now)

    monkeypatch.setattr("missions.engine.runner.perf_counter", lambda: next(now))
    run = open_run(SUAVE, seed=1, settings={"duration_s": "40"})
    run.listen(Idle())
    run.run()
    assert run.reactions
    assert all(0 < took_s < 1000 for _, took_s in run.reactions)


@pytest.mark.parametrize("service_s", [0.05, 0.17, 0.3])
def test_reactions_of_rosa_as_published_are_its_calls_times_what_one_takes(service_s):
    run = open_run(
        SUAVE, manager="rosa", seed=1, settings={"service_s": str(service_s), "duration_s": "60"}
    )
    run.run()
    for uncertainty, calls in CALLS.items():
        delays = [one.delay_s for one in run.world.reactions() if one.uncertainty == uncertainty]
        assert min(delays) == pytest.approx(calls * service_s + SWITCHING_S)
    assert run.results()["input_from_paper_service_s"] == service_s


def test_rosa_whose_services_take_no_time_does_as_we_do():
    runs = []
    for manager, settings in (("rosa", {"service_s": "0"}), ("ours", {})):
        run = open_run(find_mission("suave_extended"), manager=manager, seed=3, settings=settings)
        runs.append((run.run().outcome, run))
    (outcome, rosa), (expected, ours) = runs
    assert outcome == expected == "time_limit"
    done, doing = ([(one.action, one.result) for one in run.actions] for run in (rosa, ours))
    assert done == doing
    assert rosa.world.results()["found_s"] == pytest.approx(
        ours.world.results()["found_s"], abs=2.0
    )


@pytest.mark.parametrize("seed", range(4))
def test_rosa_as_published_recharges_once_though_it_learns_of_it_late(seed):
    run = open_run(find_mission("suave_extended"), manager="rosa", seed=seed)
    run.run()
    assert [task.action for task in run.robot.tasks].count("recharge") == 1


def test_managers_that_take_nothing_from_the_paper_do_not_say_so():
    for manager in ("ours", "none", "random", "bt", "metacontrol"):
        run = open_run(SUAVE, manager=manager, settings={"duration_s": "3"})
        run.run()
        assert not any(name.startswith("input_from_paper") for name in run.results())


def test_random_picks_every_mode_at_the_period_of_the_rules():
    for rules, period_s in (("2024", 15.0), ("2025", 30.0)):
        seen, times = set(), []
        for seed in range(3):
            run = open_run(
                SUAVE, manager="random", seed=seed, settings={"rules": rules, "start_y": "9"}
            )
            run.run()
            seen |= {(one.active, one.parameters["spiral_altitude"]) for one in run.world.history}
            first = run.world.history[0].time
            times += [(one.time - first) % period_s for one in run.world.history]
        assert {altitude for active, altitude in seen if active} == {1.0, 2.0, 3.0}
        assert any(not active for active, _ in seen)
        assert all(min(time, period_s - time) < 0.1 for time in times)


def test_options_are_set_with_or_without_their_unit_and_the_rest_is_for_the_world():
    option = Setting("delay_s", 1.5, "s", "a delay", "own choice")
    assert split_settings(SUAVE, {"bias": "0"}, [option])[2] == {"delay_s": 1.5}
    for name in ("delay", "delay_s"):
        _, world, own = split_settings(SUAVE, {name: "2", "bias": "0"}, [option])
        assert (world, own) == ({"battery": "false", "bias_m": "0"}, {"delay_s": 2.0})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"service": "1", "service_s": "2"},
            "service and service_s are the same setting; give it once",
        ),
        ({"service": "fast"}, "setting service_s is 'fast'; allowed is a number of seconds from 0"),
        ({"service": "-1"}, "setting service_s is '-1'"),
        ({"service": "inf"}, "setting service_s is 'inf'"),
        ({"reasoning_s": "1"}, "unknown setting 'reasoning_s' of mission suave"),
    ],
)
def test_options_that_cannot_be_are_refused(values, message):
    with pytest.raises(MissionError, match=message):
        open_run(SUAVE, manager="rosa", settings=values)


class Patient(Manager):
    """Puts something off four times."""

    def begin(self, task):
        self.begun_s, self.calls = self.robot.now, []
        for delay_s, name in ((2.0, "c"), (1.0, "a"), (1.0, "b"), (0.0, "now")):
            self.robot.later(
                delay_s, lambda name=name: self.calls.append((name, self.robot.now - self.begun_s))
            )


def test_what_is_put_off_comes_in_order_of_time_then_of_asking():
    run = open_run(SUAVE, manager=f"{__name__}:Patient", settings={"duration_s": "5"})
    run.run()
    calls = run._manager.calls
    assert [name for name, _ in calls] == ["now", "a", "b", "c"]
    assert [after_s for _, after_s in calls[1:]] == pytest.approx([1.0, 1.0, 2.0])


@pytest.mark.parametrize("delay_s", [-1.0, float("nan"), float("inf")])
def test_nothing_is_put_off_into_the_past_or_for_ever(delay_s):
    run = open_run(SUAVE, manager="none")
    with pytest.raises(ValueError, match="allowed is a number from 0"):
        run.robot.later(delay_s, print)
    run.world.close()


def test_listeners_change_nothing_of_a_result():
    texts = []
    for listeners in ((), (Listener(),)):
        run = open_run(SUAVE, manager="rosa", seed=4, settings={"duration_s": "50"})
        run.listen(*listeners)
        texts.append(as_json(summary(run, run.run(), 4, {})))
    assert texts[0] == texts[1]


def test_manager_is_given_as_a_class_too():
    by_name, by_class = (
        open_run(SUAVE, manager=manager, settings={"duration_s": "5", "thought": "0"})
        for manager in (f"{__name__}:Slow", Slow)
    )
    assert by_name.run() == by_class.run()
    assert by_name.world.results() == by_class.world.results()
    with pytest.raises(MissionError, match="'int' is no subclass"):
        open_run(SUAVE, manager=int)
