"""What is learned from runs: the true figures, within their intervals."""

import pytest
from running import called

from kb import KnowledgeBase, Model
from missions.baselines import open_run
from missions.engine.mission import MissionError, find_mission
from missions.experiments.comparison import mean_of
from missions.experiments.learning import Learned, learn


def logs(mission, count, **settings):
    values = {name: str(value) for name, value in settings.items()}
    runs = {}
    for seed in range(count):
        run = open_run(find_mission(mission), seed=seed, settings=values)
        run.run()
        runs[f"{mission} {seed}"] = list(run.kb.log)
    return runs


def about(learned, kind, words):
    return next(each for each in learned if each.kind == kind and each.about.startswith(words))


def test_learn_finds_the_true_rate_and_names_the_stated_one():
    model = find_mission("suave_extended").model()
    model.attributes["battery_level"].changes(-0.01)
    learned = learn(logs("suave_extended", 4, discharge_time_s=170), model)
    rate = about(learned, "rate", "battery_level, always")
    assert rate.found.mean == pytest.approx(-1 / 170)
    assert rate.found.observations == 4
    assert str(rate).endswith("; stated is -0.01")
    assert not [each for each in learned if each.about.startswith("water_visibility")]  # a wave
    assert about(learned, "duration", "search_pipeline").found.observations > 2
    assert model.attributes["battery_level"].rates[0].per_s == -0.01  # nothing is changed


def test_learn_leaves_out_what_is_held_at_a_bound():
    model = Model("sweeper")
    battery = model.quality_attribute("battery", low=0.0, high=100.0)
    model.quality_attribute("waste_load", low=0.0, high=8.0)
    model.action("sweep")
    battery.changes(-0.4, while_="sweep")
    runs = {}
    now = [0.0]
    for full in (20.0, 12.0, 9.0):
        now[0] = 0.0
        kb = KnowledgeBase(model, clock=lambda: now[0])
        kb.request_action("sweep")
        for second in range(100):
            now[0] = float(second)
            kb.measure("battery", max(full - 0.4 * second, 0.0))
            kb.measure("waste_load", min(0.25 * second, 8.0))
        kb.cancel_action("sweep", "completed")
        runs[f"from {full}"] = list(kb.log)
    learned = learn(runs, model)
    battery_rate = about(learned, "rate", "battery while sweep")
    assert battery_rate.found.mean == pytest.approx(-0.4)
    assert "; as stated -0.4" in str(battery_rate)
    assert about(learned, "rate", "waste_load while sweep").found.mean == pytest.approx(0.25)
    assert about(learned, "duration", "sweep").found.mean == 99.0
    with pytest.raises(MissionError, match="no action of drone"):
        learn(runs, Model("drone"))


def test_one_observation_has_no_interval():
    assert "no interval" in str(Learned("duration", "dig [s]", mean_of([1.0])))


def test_learn_command_reads_recordings(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ("run", "suave_extended", "--no-progress", "--set", "duration_s=130")
    for seed in ("7", "8"):
        record = ("--record", f"{seed}.mcap", "--seed", seed)
        assert called(capsys, monkeypatch, *run, *record)[0] == 0
    code, out, _ = called(
        capsys, monkeypatch, "learn", "7.mcap", "8.mcap", "--model", "suave_extended"
    )
    assert code == 0
    assert "rate: battery_level, always [1/s]: -0.005 (-0.005 to -0.005, 2 observations)" in out
    for wrong, words in (
        (("learn", "nothing.mcap", "--model", "suave_extended"), "nothing.mcap"),
        (("learn", "7.mcap", "--model", "uav"), "no action of uav"),
    ):
        code, _, err = called(capsys, monkeypatch, *wrong)
        assert code != 0
        assert words in err
