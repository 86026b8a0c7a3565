"""What is learned from runs: the simulator's true figures, within their intervals, and nothing without being asked."""

import pytest
from running import called

from kb import KnowledgeBase, Model
from missions.agv.model import DRAW_W, DRIVING_W
from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.experiments.learning import Experience, Spread, learn, spans_of


def experiences(mission, count, **settings):
    values = {name: str(value) for name, value in settings.items()}
    found = find_mission(mission)
    return [
        Experience.of(f"{mission} {seed}", open_run(found, seed=seed, settings=values))
        for seed in range(count)
    ]


def about(suggestions, kind, words):
    return next(one for one in suggestions if one.kind == kind and one.about.startswith(words))


def test_eight_runs_tell_the_true_rates_and_worth_of_the_sea_and_a_wrong_model_is_put_right():
    mission = find_mission("suave_extended")
    runs = experiences("suave_extended", 8, discharge_time_s=170)
    model = mission.model()
    model.attributes["battery_level"].changes(-0.01)
    found = learn(runs, model, mission)
    rate = about(found, "rate", "battery_level, always")
    assert rate.found.holds(-1 / 170)
    assert rate.found.observations == 8
    assert not rate.found.holds(-0.01)
    # SUAVE's follower takes a point every 2 s on the straight, more on the short and the diagonal edges
    assert (
        0.25 < about(found, "worth", "distance_inspected while inspect_pipeline").found.value < 0.3
    )
    assert not [
        one for one in found if one.kind == "rate" and "water_visibility" in one.about and one.apply
    ]  # a wave
    before = model.attributes["battery_level"].rates
    assert before[0].per_s == -0.01  # learning alone changes nothing
    rate.apply()
    (after,) = model.attributes["battery_level"].rates
    assert after.per_s == pytest.approx(-1 / 170, rel=1e-5)
    again = about(learn(runs, model, mission), "rate", "battery_level, always")
    assert (again.change, again.apply) == ("", None)


def test_rates_under_configurations_and_a_wrong_estimation_are_found():
    runs = experiences("agv", 3)
    model = find_mission("agv").model()
    fast = next(
        one for one in model.estimations if one.causer.name == "fast" and one.attribute == "energy"
    )
    model.change(fast, value=25.0)
    found = learn(runs, model)
    kinect, camera = (
        DRIVING_W["fast"] + sum(map(DRAW_W.get, one))
        for one in (("amcl", "kinect"), ("aruco", "camera"))
    )
    assert about(found, "rate", "energy while cross_c1").found.holds(-kinect)
    assert about(found, "rate", "energy while cross_c3 with aruco_camera [").found.holds(-camera)
    assert about(found, "rate", "energy while cross_c3 with aruco_camera_lamp").found.holds(
        -camera - DRAW_W["lamp"]
    )
    wrong = [one for one in found if one.kind == "estimation"]
    assert [one.about for one in wrong] == ["energy by fast [J/s]"]
    assert wrong[0].found.holds(DRIVING_W["fast"])
    assert wrong[0].stated == 25.0
    wrong[0].apply()
    assert fast.value == pytest.approx(DRIVING_W["fast"])
    assert not [one for one in learn(runs, model) if one.kind == "estimation"]


def cleaning(least):
    """Return a run that vacuums until a quarter of the battery is left, and has so much when it charges."""
    model = Model("cleaner")
    battery = model.quality_attribute("battery", low=0.0, high=1.0)
    model.action("vacuum", constraints=[battery >= 0.25])
    model.action("charge")
    now = [0.0]
    kb = KnowledgeBase(model, clock=lambda: now[0])
    kb.request_action("vacuum")
    for action, level in (
        ("vacuum", 1.0),
        ("vacuum", 0.26),
        ("charge", 0.2),
        ("charge", least),
        ("vacuum", 1.0),
    ):
        now[0] += 10.0
        kb.measure("battery", level)
        if action not in [one.action for one in kb.required_actions]:
            for one in kb.required_actions:
                kb.cancel_action(one.action, "completed" if one.action == "charge" else "abandoned")
            kb.request_action(action)
    return model, Experience("by hand", list(kb.log))


def test_a_threshold_that_leaves_much_is_too_wide_and_one_that_leaves_nothing_too_narrow():
    least = [0.15, 0.16, 0.14, 0.15, 0.16, 0.14]
    model = cleaning(0.15)[0]
    (wide,) = [
        one for one in learn([cleaning(one)[1] for one in least], model) if one.kind == "threshold"
    ]
    assert "too wide" in wide.change
    assert 0.1 < wide.found.low < 0.14  # so much will be left the next time, too
    wide.apply()
    (threshold,) = model.constraints
    assert threshold.value == pytest.approx(0.25 - wide.found.low)
    (narrow,) = [
        one
        for one in learn([cleaning(one)[1] for one in [*least, 0.0]], cleaning(0.0)[0])
        if one.kind == "threshold"
    ]
    assert (narrow.change, narrow.apply) == ("too narrow: nothing was left in 1 of them", None)
    assert not [
        one for one in learn([cleaning(0.15)[1]] * 4, model) if one.kind == "threshold"
    ]  # too few


def test_durations_are_compared_with_those_of_the_schemas():
    mission = find_mission("suave_extended")
    runs = [Experience("long", cleaning(0.2)[1].events)] * 3
    assert [
        (one.about, one.found.value, one.stated)
        for one in learn(runs, cleaning(0.2)[0])
        if one.kind == "duration"
    ] == [("charge [s]", 20.0, None)]
    found = about(
        learn(experiences("suave_extended", 3), mission.model(), mission), "duration", "recharge"
    )
    assert found.stated == 30
    assert found.found.observations == 3


def test_what_is_held_at_a_bound_says_nothing_of_its_rate():
    model = Model("sweeper")
    battery = model.quality_attribute("battery", low=0.0, high=100.0)
    model.quality_attribute("waste_load", low=0.0, high=8.0)
    model.action("sweep")
    battery.changes(-0.4, while_="sweep")
    runs, now = [], [0.0]
    for full in (20.0, 12.0, 9.0):
        kb = KnowledgeBase(model, clock=lambda: now[0])
        for second in range(100):
            now[0] = float(second)
            if second % 50 == 0:
                kb.cancel_action("sweep") if second else None
                kb.request_action("sweep")
            kb.measure("battery", max(full - 0.4 * second, 0.0))
            kb.measure("waste_load", min(0.25 * second, 8.0))
        runs.append(Experience(f"from {full}", list(kb.log)))
    found = learn(runs, model)
    assert about(found, "rate", "battery while sweep").found.value == pytest.approx(-0.4)
    assert about(found, "rate", "battery while sweep").apply is None
    assert about(found, "rate", "waste_load while sweep").found.value == pytest.approx(0.25)


def test_of_one_run_there_is_no_interval_and_nothing_is_changed():
    found = learn(experiences("suave_extended", 1), find_mission("suave_extended").model())
    assert all(one.apply is None for one in found)
    assert "no interval" in str(Spread.of([1.0]))


def test_an_interval_of_means_holds_the_true_one_as_often_as_it_says():
    import numpy

    rng = numpy.random.default_rng(0)
    held = [Spread.of(rng.normal(3.0, 2.0, 5).tolist()).holds(3.0) for _ in range(400)]
    assert 0.92 < sum(held) / len(held) < 0.98


def test_recordings_and_campaigns_are_learned_from_on_the_command_line(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.toml").write_text(
        'missions = ["suave_extended"]\nmanagers = ["ours", "bt"]\nruns = 1\nfirst_seed = 7\n'
        "settings = { duration_s = 130 }\n"
    )
    assert (
        called(capsys, monkeypatch, "campaign", "two.toml", "--workers", "1", "--out", "two")[0]
        == 0
    )
    run = (
        "run",
        "suave_extended",
        "--no-progress",
        "--set",
        "duration_s=130",
        "--record",
        "run.mcap",
    )
    assert called(capsys, monkeypatch, *run)[0] == 0
    learned = ("learn", "run.mcap", "two", "--model", "suave_extended", "--apply", "better.owl")
    code, out, _ = called(capsys, monkeypatch, *learned)
    assert code == 0
    said = "rate: battery_level, always [1/s]: -0.005 (-0.005 to -0.005, 2 observations)"
    assert said in out
    home = "missions.suave_extended.model:suave_extended_model"
    assert said in called(capsys, monkeypatch, "learn", "run.mcap", "two", "--model", home)[1]
    assert [
        rate.per_s for rate in Model.load("better.owl").attributes["battery_level"].rates
    ] == pytest.approx([-0.005])
    for wrong, words in (
        (learned, "better.owl is there already"),
        (("learn", "nothing.mcap", "--model", "suave_extended"), "nothing.mcap"),
        (("learn", "run.mcap", "--model", "suave_extendet"), "suave_extended"),
        (
            ("learn", "run.mcap", "--model", "suave", "--take", "worth"),
            "what can be changed is rate",
        ),
        (("learn", "run.mcap", "--model", "uav"), "no action of uav"),
        (
            ("learn", "two.toml", "--model", "suave"),
            "--record FILE.mcap` also keeps what was decided",
        ),
    ):
        code, _, said = called(capsys, monkeypatch, *wrong)
        assert code != 0
        assert words in said


def test_configuration_of_a_component_that_no_selected_design_uses_is_not_named():
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera, lidar = (
        model.component("camera", kind="lifecycle"),
        model.component("lidar", kind="lifecycle"),
    )
    camera.configuration("night", {"exposure_s": 0.2})
    lidar.configuration("slow", {"rate": 1})
    see = model.function("see")
    see.design("by_camera", [camera], priority=1, constraints=[light >= 0.1])
    see.design("by_lidar", [lidar], priority=2)
    model.action("explore", requires=[see])
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    kb.request_action("explore")
    kb.finish_plan(kb.select({"see": "by_camera"}, {"camera": "night"}), "completed")
    kb.measure("light", 0.0)
    kb.finish_plan(kb.select({"see": "by_lidar"}, {"lidar": "slow"}), "completed")
    assert kb.configurations["night"].is_selected  # of a component that nothing uses now
    assert spans_of(Experience("one", list(kb.log)), model)[-1].chosen == {"by_lidar", "slow"}
