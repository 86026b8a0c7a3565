"""The picture of a run: that it is there, is always the same, and shows what happened."""

from dataclasses import replace
from functools import cache
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Text

from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.views.picture import draw, picture
from missions.views.recorder import RunRecorder


def recorded(name="suave_extended", task="bt", seed=0, manager="ours", **changed):
    """Return what there is to see of a run of a mission."""
    settings = {key: str(value) for key, value in changed.items()}
    run = open_run(find_mission(name), manager=manager, task=task, seed=seed, settings=settings)
    page = RunRecorder(run, seed, settings, what_if=False)
    page.end(run.run())
    return page.recorder.recorded


@cache
def short_run(name="suave_extended", task="bt"):
    return recorded(name, task, duration_s=40)


@cache
def pictured(name="suave_extended", task="bt"):
    """Return the picture of a short run, drawn once for all tests that only look at it."""
    return picture(short_run(name, task))


def without(run, *tracks):
    return replace(run, rows=[row for row in run.rows if row[1] not in tracks])


def tracked(run, name):
    return list(run.last(name).values())


def words(axes):
    return [text.get_text() for text in axes.texts]


def axes_beside(figure, word):
    return next(axes for axes in figure.axes if word in words(axes))


def panel(figure, name):
    labels = {" ".join(axes.get_ylabel().split()[:-1]): axes for axes in figure.axes}
    return labels[name]


def test_png_has_its_size_is_not_blank_and_is_the_same_twice():
    run = short_run("suave_extended", "pddl")
    png = draw(run)
    pixels = imread(BytesIO(png))
    assert pixels.shape[:2] == (1200, 1600)
    assert np.ptp(pixels) == 1
    assert draw(run) == png


def test_map_list_and_time_axis_carry_the_number_of_every_adaptation():
    run = short_run()
    kinds = [one["kind"] for one in tracked(run, "adaptation")]
    assert {"parameter", "structural"} <= set(kinds)
    figure = pictured()
    numbers = {str(number) for number in range(1, len(kinds) + 1)}
    map_axes = axes_beside(figure, "start")
    assert sorted(word for word in words(map_axes) if word in numbers) == sorted(numbers)
    assert f"end, {run.rows[-1][0]:.0f} s" in words(map_axes)
    carriers = [axes for axes in figure.axes if numbers <= set(words(axes))]
    assert carriers == [figure.axes[4], map_axes], "the lanes and the map"
    (listed,) = words(figure.axes[5])
    assert all(f"\n {number}   " in listed for number in numbers)


def test_disturbances_have_their_lines():
    told = tracked(short_run(), "disturbance")
    lines = [line for line in pictured().axes[0].lines if line.get_color() == "#d55e00"]
    assert [line.get_xdata()[0] for line in lines] == [one["t"] for one in told]


def test_what_crowds_on_the_map_is_written_beside_one_another():
    figure = pictured()
    figure.canvas.draw()
    map_axes = axes_beside(figure, "start")
    shown = [Text.get_window_extent(text) for text in map_axes.texts]
    assert len(shown) > len(tracked(short_run(), "adaptation")) + 1, (
        "the start, a place and each adaptation"
    )
    for number, box in enumerate(shown):
        assert box.count_overlaps(shown[:number]) == 0, map_axes.texts[number].get_text()


def test_run_without_a_place_has_taller_panels_instead_of_a_map():
    run = short_run()
    tall = panel(pictured(), "water visibility").bbox.height
    figure = picture(without(run, "pose"))
    assert panel(figure, "water visibility").bbox.height > 1.2 * tall
    assert "start" not in [word for axes in figure.axes for word in words(axes)]


@pytest.mark.parametrize("signal", ["water visibility", "battery level"])
def test_thresholds_are_those_of_the_model(signal):
    model = find_mission("suave_extended").model()
    limits = [
        constraint
        for constraint in model.constraints
        if constraint.attribute == signal.replace(" ", "_")
    ]
    assert limits
    axes = panel(pictured(), signal)
    lines = [line.get_ydata()[0] for line in axes.lines]
    assert {limit.value for limit in limits} <= set(lines)
    beside = "\n".join(words(axes))
    assert all(f"≥ {limit.value:g}  " in beside for limit in limits)
    assert any(each.name in beside for limit in limits for each in limit.constrained)


def test_the_map_has_the_same_scale_both_ways():
    axes = axes_beside(pictured(), "start")
    assert axes.get_aspect() == 1
    width = np.ptp(axes.get_xlim())
    height = np.ptp(axes.get_ylim())
    assert width / height == pytest.approx(axes.bbox.width / axes.bbox.height)


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_hardly_any_samples_are_drawn_all_the_same(samples):
    run = short_run()
    times = [row[0] for row in run.rows if row[1] == "pose"][:samples]
    assert draw(
        replace(
            run,
            rows=[row for row in run.rows if row[1] not in ("pose", "signal") or row[0] in times],
        )
    )


def test_a_run_in_which_nothing_happened_says_so():
    run = short_run()
    assert any(
        "no adaptation\n" in words(axes)
        for axes in picture(without(run, "adaptation", "disturbance")).axes
    )


def test_signals_that_are_missing_and_names_that_look_like_formulas_do_no_harm():
    run = short_run()
    odd = [(time, "signal", "odd $x [m]", time) for time, track, *_ in run.rows if track == "pose"]
    dark = [(time, "signal", "gap [m]", None) for time, *_ in odd]
    rows = sorted([*without(run, "value").rows, *odd, *dark], key=lambda row: row[0])
    signals = ["battery_level", "odd_$x", "gap"]
    strange = replace(run, rows=rows, header={**run.header, "signals": signals})
    figure = picture(strange)
    assert panel(figure, "odd $x")
    assert not [axes for axes in figure.axes if axes.get_ylabel().startswith(("battery", "gap"))]
    assert draw(strange)


def test_a_great_many_adaptations_are_cut_off_in_the_list_with_a_word():
    run = short_run()
    rows = [
        (time, track, f"{key}.{copy}", value)
        for time, track, key, value in run.rows
        for copy in range(12)
    ]
    many = [row for row in rows if row[1] == "adaptation"]
    figure = picture(replace(run, rows=[*run.rows[:-1], *many, run.rows[-1]]))
    assert any("\n… and" in word for axes in figure.axes for word in words(axes))


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
    figure = pictured(name, task)
    written = boxes(figure)
    assert len(written) > 10
    for text, box in written.items():
        assert box.x0 >= 0, text
        assert box.x1 <= figure.bbox.x1, text
    (legend,) = figure.legends
    assert legend.get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.parametrize("count", [4, 12])
def test_long_names_and_reasons_stay_within_the_picture(count):
    run = short_run("uav")
    long = (
        "pick_up_and_analyse is unfeasible because battery_level 0.549 violates >= 0.55 "
        "(measured 0.0 s ago)"
    )
    change = (
        "plan anew, with search_for_samples(sample_8, drone), pick_up_and_analyse(sample_8, drone)"
    )
    one = {
        "t": 3.0,
        "kind": "task",
        "cause": "battery_level is 0.549",
        "decided": long,
        "changed": change,
    }
    told = [(3.0, "adaptation", number, {**one, "reaction": 0.2}) for number in range(count)]
    figure = picture(
        replace(run, rows=[*without(run, "adaptation").rows[:-1], *told, run.rows[-1]])
    )
    for text, box in boxes(figure).items():
        assert box.x1 <= figure.bbox.x1, text


def test_lanes_show_which_design_and_which_configuration_was_chosen():
    (lanes,) = [axes for axes in pictured("agv").axes if axes.get_xlabel() == "time [s]"]
    shown = [label.get_text() for label in lanes.get_yticklabels()]
    assert shown[-2:] == ["amcl_kinect", "aruco_camera"]
    assert "fast" in shown


def test_title_writes_units_as_they_are_written():
    title = " ".join(text.get_text() for text in pictured("agv").texts)
    assert " J   " in title
    assert title.endswith("collisions 0")


def test_run_of_a_manager_without_a_knowledge_base_is_drawn_with_its_actions():
    figure = picture(recorded(manager="bt", duration_s=30))
    lanes = next(axes for axes in figure.axes if axes.get_xlabel() == "time [s]")
    assert "search_pipeline" in [label.get_text() for label in lanes.get_yticklabels()]
    assert not [axes for axes in figure.axes if "adaptation" in " ".join(words(axes))]
