"""Managers of the vehicle: what is measured on the published runs, their modes, and one of a user's own."""

import json
from functools import cache
from statistics import mean

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.baselines import MANAGERS, Manager, find_manager, modes, open_run
from missions.baselines.modes import SystemModes
from missions.engine.mission import MissionError, find_mission
from missions.engine.runner import Listener
from missions.views.output import as_json, summary

# start y [m], visibility shift [s]; then search time [s] and distance [m] as published, of none and of the tree:
# rules of 2025, 250 s, visibility period 120 s, no thruster failure
PUBLISHED = {
    (2.80, 84.7): {"none": (181.5, 16.6), "bt": (44.5, 60.1)},
    (3.15, 9.6): {"none": (183.5, 16.0), "bt": (111.0, 37.7)},
    (3.28, 40.2): {"none": (184.5, 15.6), "bt": (122.0, 35.4)},
}

# the same with thrusters 1 and 3 stuck from then on [s]: of five searches of none, how many found the pipeline, from
# when to when [s]
STUCK = {
    (2.80, 84.7): (146.4, 4, (184, 237)),
    (3.15, 9.6): (91.2, 5, (188, 196)),
    (3.28, 40.2): (61.9, 4, (190, 193)),
}


class Heard(Listener):
    def __init__(self):
        self.messages = []

    def message(self, message):
        self.messages.append(message)


def managed(manager, mission="suave", seed=0, listeners=(), **changed):
    changes = {name: str(value) for name, value in changed.items()}
    run = open_run(find_mission(mission), manager=manager, seed=seed, settings=changes)
    run.listen(*listeners)
    return run, run.run()


@cache
def extended(manager, seed=0):
    heard = Heard()
    run, verdict = managed(manager, "suave_extended", seed, [heard])
    return run, verdict, heard.messages


@pytest.mark.parametrize("manager", ["none", "bt"])
@pytest.mark.parametrize("group", PUBLISHED)
def test_search_time_and_distance_are_those_of_the_published_runs(group, manager):
    start_y, shift = group
    search_s, distance_m = PUBLISHED[group][manager]
    changed = {"start_y": start_y, "visibility_shift": shift, "bias": 0, "duration_s": 250}
    results = [
        managed(manager, seed=seed, rules="2025", **changed)[0].world.results() for seed in range(2)
    ]
    assert mean(one["search_time_s"] for one in results) == pytest.approx(search_s, abs=4)
    assert mean(one["distance_inspected_m"] for one in results) == pytest.approx(
        distance_m, rel=0.1
    )


@pytest.mark.parametrize("group", STUCK)
def test_a_search_with_two_stuck_thrusters_ends_as_the_published_ones_did(group):
    (start_y, shift), (stuck_s, found, (earliest_s, latest_s)) = group, STUCK[group]
    events = f"1 failure {stuck_s}, 3 failure {stuck_s}"
    changed = {
        "start_y": start_y,
        "visibility_shift": shift,
        "thruster_events": events,
        "duration_s": 250,
    }
    results = [
        managed("none", seed=seed, rules="2025", **changed)[0].world.results() for seed in range(5)
    ]
    times = [one["search_time_s"] for one in results if one["search_time_s"] is not None]
    assert len(times) >= found
    assert earliest_s - 4 <= mean(times) <= latest_s + 20


@pytest.mark.parametrize("manager", ["none", "bt"])
def test_half_the_step_of_the_physics_changes_next_to_nothing(manager):
    changed = {"rules": "2025", "start_y": 2.8, "visibility_shift": 84.7, "duration_s": 250}
    whole, half = (
        managed(manager, physics_step_s=step, **changed)[0].world.results() for step in (0.02, 0.01)
    )
    assert whole["found_s"] == pytest.approx(half["found_s"], abs=1)
    assert whole["distance_inspected_m"] == pytest.approx(half["distance_inspected_m"], rel=0.02)


@pytest.mark.parametrize("manager", MANAGERS)
def test_same_seed_gives_the_same_bytes_under_every_manager(manager):
    texts = []
    for _ in range(2):
        run, verdict = managed(manager, "suave_extended", 5, duration_s=60)
        texts.append(as_json(summary(run, verdict, 5, {})))
    assert texts[0] == texts[1]
    assert json.loads(texts[0])["actions"]


def test_managers_meet_the_same_world():
    first = {}
    for manager in ("ours", *MANAGERS):
        heard = Heard()
        managed(manager, seed=3, listeners=[heard], duration_s=20)
        first[manager] = [
            m for m in heard.messages if m["status"][0]["name"] == "water_visibility_monitor"
        ]
    assert len(first["ours"]) > 10
    assert all(messages == first["ours"] for messages in first.values())


def test_without_adaptation_the_altitude_stays_and_no_thruster_recovers():
    run, _ = managed("none", seed=1, duration_s=120)
    history = run.world.history
    assert {change.component for change in history} <= {"spiral_search", "follow_pipeline"}
    assert {
        change.parameters["spiral_altitude"]
        for change in history
        if change.component == "spiral_search"
    } == {1.0}
    assert run.world.results()["uncorrected"] > 0


def test_the_tree_follows_the_visibility_and_recovers_the_thruster():
    run, _, messages = extended("bt")
    altitudes = [
        change.parameters["spiral_altitude"]
        for change in run.world.history
        if change.component == "spiral_search" and change.active
    ]
    assert set(altitudes) == {1.0, 2.0, 3.0}
    assert (
        run.world.results()["uncorrected"] <= 1
    )  # at most that the search ended before it was corrected
    assert any(
        "RECOVERED" in status["values"].values()
        for message in messages
        for status in message["status"]
    )


def test_the_tree_recharges_once_and_then_inspects_what_is_left():
    run, verdict, _ = extended("bt")
    assert verdict.outcome == "time_limit"
    assert [(task.action, task.result) for task in run.robot.tasks] == [
        ("search_pipeline", "completed"),
        ("inspect_pipeline", "abandoned"),
        ("recharge", "completed"),
        ("inspect_pipeline", "abandoned"),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_the_tree_misses_the_first_low_level_because_it_compares_single_precision(seed):
    run, _, messages = extended("bt", seed)
    levels = [
        (message["time"], float(status["values"]["battery_level"]))
        for message in messages
        for status in message["status"]
        if "battery_level" in status["values"]
    ]
    low_s = next(time for time, level in levels if level < 0.25)
    begun_s = next(change.time for change in run.world.history if change.component == "recharge")
    assert 1.0 < begun_s - low_s < 1.2


def test_mission_node_polls_once_a_second_by_the_rules_of_2024_and_ten_times_by_those_of_2025():
    waits = {}
    for rules in ("2024", "2025"):
        run, _ = managed("none", seed=2, rules=rules, start_y=0.0, duration_s=10)
        inspect = next(task for task in run.robot.tasks if task.action == "inspect_pipeline")
        waits[rules] = inspect.start - run.world.results()["found_s"]
    assert (
        0.1 < waits["2024"] < 2.0
    )  # twice the period at most, if it is found before the search is begun
    assert 0 <= waits["2025"] < 0.2


OWN = '''
from missions.baselines import Manager


class Cautious(Manager):
    """Searches as high as the water allows with half a metre to spare, and recovers thrusters."""

    period_s = 0.5

    def begin(self, task):
        self.robot.activate("spiral_search" if task == "search_pipeline" else "follow_pipeline")

    def end(self, task):
        self.robot.deactivate("spiral_search" if task == "search_pipeline" else "follow_pipeline")

    def update(self):
        altitude = max(1.0, self.robot.measured.get("water_visibility", 0.0) - 0.5)
        if self.robot.task == "search_pipeline":
            self.robot.set_parameters("spiral_search", {"spiral_altitude": altitude})
        if "FALSE" in self.robot.reported.values() and not self.robot.is_active("recover_thrusters"):
            self.robot.activate("recover_thrusters")
'''


def test_manager_of_ones_own_is_run_by_its_name(tmp_path, monkeypatch):
    (tmp_path / "cautious.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    run, verdict = managed("cautious:Cautious", seed=1)
    assert verdict.success
    altitudes = {
        c.parameters["spiral_altitude"] for c in run.world.history if c.component == "spiral_search"
    }
    assert len(altitudes) > 10
    assert any(change.component == "recover_thrusters" for change in run.world.history)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "bd",
            "'bd'; there are ours, none, random, fixed, bt, metacontrol, rosa, ahead; one of your own is given",
        ),
        ("nowhere:Thing", "cannot import manager 'nowhere:Thing': there is no module nowhere"),
        ("json:Thing", "cannot import manager 'json:Thing': json has no 'Thing'"),
        ("json:loads", "'json:loads' is no subclass of missions.baselines.Policy or Manager"),
    ],
)
def test_manager_that_cannot_be_had_is_refused_with_those_there_are(name, message):
    with pytest.raises(MissionError) as refusal:
        find_manager(name, find_mission("suave"))
    assert message in str(refusal.value)


def test_manager_with_a_task_layer_of_ours_or_rules_that_do_not_exist_are_refused():
    suave = find_mission("suave")
    with pytest.raises(MissionError, match="--manager bt comes without one"):
        open_run(suave, manager="bt", task="pddl")
    with pytest.raises(MissionError, match="there are no rules '2023'; known are 2024, 2025"):
        open_run(suave, settings={"rules": "2023"})
    with pytest.raises(MissionError, match="bias and bias_m are the same setting"):
        open_run(suave, settings={"bias": "0", "bias_m": "1"})


class Nodes:
    """Components that obey at once, and count what they are asked for."""

    def __init__(self):
        self.active, self.values, self.asked = {}, {}, 0

    def activate(self, name):
        self.active[name], self.asked = True, self.asked + 1

    def deactivate(self, name):
        self.active[name], self.asked = False, self.asked + 1

    def set_parameters(self, name, values):
        self.values.setdefault(name, {}).update(values)
        self.asked += 1

    def is_active(self, name):
        return self.active.get(name, False)

    def parameters(self, name):
        return self.values.get(name, {})


def inferred_of(modes, function):
    return next(mode for mode in FUNCTIONS[function] if modes.is_in(function, mode))


COMPONENTS = {
    "f_generate_search_path": "spiral_search",
    "f_follow_pipeline": "follow_pipeline",
    "f_maintain_motion": "recover_thrusters",
    "f_generate_recharge_path": "recharge",
}
FUNCTIONS = {function: list(modes.FUNCTIONS[function][1]) for function in COMPONENTS}
REQUESTS = st.sampled_from(
    [(function, mode) for function, modes in FUNCTIONS.items() for mode in modes]
)


@settings(max_examples=50, deadline=None)
@given(st.lists(REQUESTS, min_size=1, max_size=12))
def test_mode_asked_for_last_is_the_one_inferred_or_means_the_same(requests):
    nodes = Nodes()
    modes = SystemModes(nodes)
    for function, mode in requests:
        modes.request(function, mode)
    for function, mode in dict(requests).items():
        inferred = inferred_of(modes, function)
        again = Nodes()
        twin = SystemModes(again)
        twin.request(function, inferred)
        assert inferred_of(twin, function) == inferred
        assert FUNCTIONS[function].index(inferred) <= FUNCTIONS[function].index(mode)
        assert nodes.is_active(COMPONENTS[function]) == again.is_active(COMPONENTS[function])


@given(REQUESTS)
def test_mode_asked_for_twice_is_asked_for_once(request_):
    nodes = Nodes()
    modes = SystemModes(nodes)
    modes.request(*request_)
    asked = nodes.asked
    modes.request(*request_)
    assert nodes.asked == asked


class Faulty(Manager):
    def begin(self, task):
        self.robot.activate("spiral_serch")


class Hasty(Manager):
    period_s = 0


class Forgetful(Manager):
    decides_tasks = True

    def update(self):
        self.robot.end("completed")


class Restless(Manager):
    decides_tasks = True

    def update(self):
        self.robot.begin("search_pipeline")


@pytest.mark.parametrize(
    ("manager", "said"),
    [
        (Faulty, r"Faulty failed after \d\.\d\d s: .*'spiral_serch'.*test_managers.py, line \d+$"),
        (Hasty, "period_s is 0; allowed is a number of seconds above 0"),
        (Forgetful, r"Forgetful failed .*no task is being done.*test_managers.py, line \d+$"),
        (
            Restless,
            r"Restless failed .*search_pipeline is being done; end it first.*test_managers.py, line \d+$",
        ),
    ],
)
def test_what_a_manager_does_wrong_is_told_with_its_name_the_moment_and_the_line(manager, said):
    with pytest.raises(MissionError, match=said):
        managed(manager, duration_s=20)


def test_a_battery_that_ran_low_and_was_never_recharged_is_no_success():
    _, verdict, _ = extended("none", 1)
    assert not verdict.success
    assert "battery ran low" in verdict.reason


def test_metacontrol_answers_a_second_failure_as_it_did_the_first():
    events = {"thruster_events": "1 failure 35, 3 failure 60", "thruster_events_chained": "false"}
    run, _ = managed("metacontrol", seed=1, duration_s=90, **events)
    starts = [one.start_s for one in run.world.reactions() if one.uncertainty == "U1"]
    assert [start // 10 for start in starts] == [3, 6]
    assert run.world._env.observe().thrusters_failed == ()
