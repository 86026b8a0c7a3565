"""The picture of a run: that it is there, is always the same, and shows what happened."""

from copy import copy
from dataclasses import replace
from functools import cache
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread
from running import run_mission

from missions.agv.world import BuildingWorld
from missions.engine.runner import Seen
from missions.views.picture import draw, picture


@cache
def short_run(name="suave_extended", task="bt"):
    run, _, data = run_mission(name, task, seed=0, duration_s=40)
    return run, data


def words(axes):
    return [text.get_text() for text in axes.texts]


def axes_beside(figure, word):
    return next(axes for axes in figure.axes if word in words(axes))


def panel(figure, name):
    return next(axes for axes in figure.axes if axes.get_ylabel().split("\n")[:-1] == name.split())


@pytest.mark.parametrize(("name", "task"), [("suave", "bt"), ("suave_extended", "pddl")])
def test_png_has_its_size_is_not_blank_and_is_the_same_twice(name, task):
    run, data = short_run(name, task)
    png = draw(run, data)
    pixels = imread(BytesIO(png))
    assert pixels.shape[:2] == (1200, 1600)
    assert np.ptp(pixels) == 1
    assert draw(run, data) == png


def test_map_list_and_time_axis_carry_the_number_of_every_adaptation():
    run, data = short_run()
    kinds = [one["kind"] for one in data["adaptations"]]
    assert {"parameter", "structural"} <= set(kinds)
    figure = picture(run, data)
    numbers = {str(number) for number in range(1, len(kinds) + 1)}
    map_axes = axes_beside(figure, "start")
    on_map = [word for axes in (map_axes, *map_axes.child_axes) for word in words(axes) if word in numbers]
    assert sorted(on_map) == sorted(numbers)
    carriers = [axes for axes in figure.axes if numbers <= set(words(axes))]
    assert axes_beside(figure, "adaptations") in carriers
    assert len({*carriers} - {map_axes}) == 2


def test_what_crowds_on_the_map_is_shown_larger_in_a_corner_and_hides_nothing():
    run, data = short_run()
    map_axes = axes_beside(picture(run, data), "start")
    (lens,) = map_axes.child_axes
    assert lens.get_aspect() in ("auto", 1)
    seen, whole = lens.get_window_extent(), map_axes.transData
    path = whole.transform([sample.position[:2] for sample, _ in run.trace])
    assert not any(seen.contains(*point) for point in path)
    scales = [axes.bbox.width / np.ptp(axes.get_xlim()) for axes in (map_axes, lens)]
    assert scales[1] > 2 * scales[0]
    assert scales[1] == pytest.approx(lens.bbox.height / np.ptp(lens.get_ylim()))


def test_title_rounds_a_figure_once(monkeypatch):
    run, data = short_run()
    monkeypatch.setattr(run, "results", lambda: {"speed_m_s": 0.511})
    assert any("0.51" in text.get_text() for text in picture(run, data).texts)


def test_failure_that_only_diagnostics_tell_of_is_marked_as_a_disturbance():
    run, data = short_run()
    quiet = {**data, "disturbances": []}
    assert "c_thruster_1 has failed" in words(axes_beside(picture(run, quiet), "disturbances"))
    assert "c_thruster_1 has failed" not in words(axes_beside(picture(run, data), "disturbances"))


def test_run_without_a_place_has_taller_panels_instead_of_a_map():
    run, data = short_run()
    tall = panel(picture(run, data), "water visibility").bbox.height
    trace = [(replace(sample, position=(np.nan,) * 3), seen) for sample, seen in run.trace]
    nowhere = copy(run)
    nowhere.trace = trace
    figure = picture(nowhere, data)
    assert panel(figure, "water visibility").bbox.height > 1.2 * tall
    assert "start" not in [word for axes in figure.axes for word in words(axes)]


def test_disturbance_that_its_signal_shows_crosses_no_other_row():
    run, data = short_run()
    figure = picture(run, data)
    lines = [line for line in axes_beside(figure, "adaptations").lines if line.get_color() == "#d55e00"]
    others = [one["at_s"] for one in data["disturbances"] if not one["what"].startswith(("water", "battery"))]
    assert others
    assert [line.get_xdata()[0] for line in lines] == others


@pytest.mark.parametrize("signal", ["water visibility", "battery level"])
def test_thresholds_are_those_of_the_model(signal):
    run, data = short_run()
    limits = [one for one in run.kb.model.constraints if one.attribute == signal.replace(" ", "_")]
    assert limits
    axes = panel(picture(run, data), signal)
    lines = [float(path.vertices[0, 1]) for group in axes.collections for path in group.get_paths()]
    assert {one.value for one in limits} <= set(lines)
    beside = "\n".join(words(axes))
    assert all(f"≥ {one.value:g}  {each.name}" in beside for one in limits for each in one.constrained)


def test_a_signal_shares_the_panel_of_the_signal_that_ends_its_name():
    run, data = short_run()
    legend = panel(picture(run, data), "altitude").get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["altitude", "search altitude"]


def test_a_disturbance_is_marked_on_its_signal_or_told_in_words():
    run, data = short_run()
    figure = picture(run, data)
    told = words(axes_beside(figure, "disturbances"))
    seen = [one for one in data["disturbances"] if one["what"].startswith("water visibility")]
    others = [one["what"] for one in data["disturbances"] if one not in seen]
    assert seen
    assert others
    assert told == ["disturbances", *others]
    marked = [line.get_xdata() for line in panel(figure, "water visibility").lines if line.get_marker() == "D"]
    assert sorted(float(np.ravel(x)[0]) for x in marked) == [one["at_s"] for one in seen]


def test_the_map_has_the_same_scale_both_ways():
    run, data = short_run()
    axes = axes_beside(picture(run, data), "start")
    assert axes.get_aspect() == 1
    width, height = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
    assert width / height == pytest.approx(axes.bbox.width / axes.bbox.height)


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_hardly_any_samples_are_drawn_all_the_same(samples):
    run, _, data = run_mission("suave_extended", duration_s=20)
    run.trace = run.trace[:samples]
    assert draw(run, data)


def test_a_run_in_which_nothing_happened_says_so():
    run, data = short_run()
    calm = {**data, "adaptations": [], "disturbances": []}
    assert any("no adaptation" in words(axes) for axes in picture(run, calm).axes)


def test_signals_that_are_missing_and_names_that_look_like_formulas_do_no_harm():
    run, _, data = run_mission("suave_extended", duration_s=20)
    run.trace = [
        (replace(sample, signals={"battery level [-]": float("nan"), "odd $x [m]": sample.time}), Seen("$a, b", "c$"))
        for sample, _ in run.trace
    ]
    figure = picture(run, data)
    assert panel(figure, "odd $x")
    assert not [axes for axes in figure.axes if axes.get_ylabel().startswith("battery")]
    assert draw(run, data)


def test_a_great_many_adaptations_are_cut_off_in_the_list_with_a_word():
    run, data = short_run()
    many = [one for one in data["adaptations"] for _ in range(12)]
    figure = picture(run, {**data, "adaptations": many})
    assert any(word.startswith("… and") for axes in figure.axes for word in words(axes))


def boxes(figure):
    """Each text that is written, with its box [px]."""
    return {
        text.get_text(): text.get_window_extent()
        for axes in figure.axes
        for text in (*axes.texts, *axes.get_yticklabels())
        if text.get_text()
    }


@pytest.mark.parametrize(("name", "task"), [("agv", "bt"), ("uav", "bt"), ("suave_extended", "bt")])
def test_nothing_that_is_written_is_cut_off_at_the_edges(name, task):
    figure = picture(*short_run(name, task))
    written = boxes(figure)
    assert len(written) > 10
    for text, box in written.items():
        assert box.x0 >= 0, text
        assert box.x1 <= figure.bbox.x1, text
    (legend,) = figure.legends
    assert legend.get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.parametrize("count", [4, 7, 12])
def test_long_names_and_reasons_stay_within_the_picture(count):
    run, data = short_run("uav")
    long = "pick_up_and_analyse is unfeasible because battery_level 0.549 violates >= 0.55 (measured 0.0 s ago)"
    change = "plan anew, with search_for_samples(sample_8, drone), pick_up_and_analyse(sample_8, drone)"
    one = {"at_s": 3.0, "kind": "task", "trigger": "battery_level is 0.549", "reason": long, "change": change}
    figure = picture(run, {**data, "adaptations": [{**one, "reaction_s": 0.2}] * count})
    for text, box in boxes(figure).items():
        assert box.x1 <= figure.bbox.x1, text


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_list_begins_with_the_first_plan_and_why_it_was_made(task):
    run, data = short_run("agv", task)
    first = data["plans"][0]
    told = words(next(axes for axes in picture(run, data).axes if any("first plan" in word for word in words(axes))))
    assert told[1:3] == [f"{first['at_s']:.1f} s", "plan"]
    text = " ".join(" ".join(told[3:]).split())
    assert text.startswith(f"first plan: {first['reason']} → {first['steps'][0]}")
    assert "[solved optimally, " in text
    assert text.index("first plan") < text.index("kinect has failed")
    numbers = [word for word in told if word.isdigit()]
    assert numbers == [str(number) for number in range(1, len(data["adaptations"]) + 1)]


def test_first_plan_is_in_the_list_of_a_run_without_adaptation_and_leaves_the_others_room():
    run, _, data = run_mission("agv", incidents="", duration_s=10)
    shown = [words(axes) for axes in picture(run, data).axes]
    assert next(told for told in shown if any(word.startswith("first plan") for word in told))[0] == "no adaptation"
    run, data = short_run("uav", "pddl")
    assert len(data["plans"][0]["steps"]) > 4
    told = [" ".join(words(axes)) for axes in picture(run, data).axes]
    assert any(f"then {len(data['plans'][0]['steps']) - 3} more" in " ".join(text.split()) for text in told)


def test_lanes_show_which_design_and_which_configuration_was_chosen():
    run, data = short_run("agv")
    lanes = [axes for axes in picture(run, data).axes if {"design", "configuration"} & set(words(axes))]
    shown = [[label.get_text() for label in axes.get_yticklabels()] for axes in lanes]
    assert shown[0] == ["amcl_kinect", "aruco_camera"]
    assert shown[1] == ["fast"]  # the navigator's headings say no more than the corridors do


def test_map_says_on_each_corridor_what_was_chosen_for_it():
    run, data = short_run("agv")
    told = words(axes_beside(picture(run, data), "start"))
    assert {"amcl_kinect, fast", "aruco_camera, fast"} <= set(told)


def test_map_of_a_run_in_which_only_one_thing_is_chosen_says_nothing_of_it():
    run, data = short_run("suave_extended")
    assert not any("thruster" in word for word in words(axes_beside(picture(run, data), "start")))


def test_ring_in_the_colour_of_the_action_marks_where_it_was_completed():
    run, data = short_run("uav")
    rings = [line for line in axes_beside(picture(run, data), "start").lines if line.get_markerfacecolor() == "none"]
    done = [one for one in data["actions"] if one["result"] == "completed"]
    assert len(rings) == len(done) > 2
    assert len({line.get_color() for line in rings}) == len({one["name"] for one in done})


def test_title_writes_units_as_they_are_written():
    run, data = short_run("agv")
    title = " ".join(text.get_text() for text in picture(run, data).texts)
    assert " J   " in title
    assert title.endswith("collisions 0")


def test_map_with_a_crowd_of_places_names_those_that_the_way_leads_along(monkeypatch):
    run, data = short_run("agv")
    own = run.world.scenery()
    crowd = {f"aisle {number}": np.linspace([number, 2.0], [number, 5.0], 9) for number in range(20)}
    monkeypatch.setattr(run.world, "scenery", lambda: own | crowd)
    named = set(words(axes_beside(picture(run, data), "start")))
    assert {"c1, obstructed", "c4"} & named
    assert not named & set(crowd)
    monkeypatch.setattr(run.world, "scenery", lambda: own | dict(list(crowd.items())[:10]))
    assert len(set(words(axes_beside(picture(run, data), "start"))) & set(crowd)) == 10


def test_time_is_marked_once_where_the_vehicle_stands(monkeypatch):
    monkeypatch.setattr(BuildingWorld, "is_still", False)  # so that it stands to the end
    run, _, data = run_mission("agv", seed=1, capacity_j=2500)
    marks = [word for word in words(axes_beside(picture(run, data), "start")) if word.endswith(" s")]
    assert data["duration_s"] == 300
    assert len(marks) == 1
