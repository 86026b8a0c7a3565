"""The page in a real browser: a report of a real run, clicked through.

And a mission watched while it runs.
"""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from browsing import CHROMIUM, QUIET, WAIT_MS, needs_browser
from test_live import mission

from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.views.recorder import RunRecorder
from missions.views.report import page_of, report

sync_api = pytest.importorskip("playwright.sync_api")
AXE = (
    Path(__file__).parents[2]
    / "missions"
    / "views"
    / "page"
    / "node_modules"
    / "axe-core"
    / "axe.min.js"
)
WIDTHS = (375, 768, 1440)
VIEWS = ("#scene", "#timelines", "#tree", "#knowledge")
MISSIONS = (("suave_extended", "bt"), ("uav", "bt"), ("agv", "pddl"))

sync_api.expect.set_options(timeout=WAIT_MS)
pytestmark = needs_browser


@cache
def recorded(mission, task="bt", seed=0):
    run = open_run(find_mission(mission), manager="ours", task=task, seed=seed, settings={})
    page = RunRecorder(run, seed, {})
    page.end(run.run())
    return page.recorder.recorded


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        yield opened
        opened.close()


class Visits:
    """Opens pages, and keeps what went wrong in them and what they asked for."""

    def __init__(self, browser, folder):
        self._browser = browser
        self._folder = folder
        self._contexts = []
        self.wrong = []
        self.requests = []
        self.outlives_its_mission = False

    def file(self, text):
        path = self._folder / f"page_{len(list(self._folder.iterdir()))}.html"
        path.write_text(text, encoding="utf-8")
        return path.as_uri()

    def show(self, url, width=1440, height=900, scheme="light"):
        context = self._browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme
        )
        self._contexts.append(context)
        context.set_default_timeout(WAIT_MS)
        page = context.new_page()
        page.on(
            "console",
            lambda said: (
                self.wrong.append(said.text) if said.type in ("error", "warning") else None
            ),
        )
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda opened: self.requests.append(opened.url))
        page.goto(url)
        page.wait_for_selector(".transport")
        settle(page)
        return page

    def close(self):
        for context in self._contexts:
            context.close()


@pytest.fixture
def visits(browser, tmp_path):
    """Whatever a test does, nothing leaves the machine, and nothing goes wrong unseen."""
    opened = Visits(browser, tmp_path)
    yield opened
    opened.close()
    # a page asks again and again for the mission that is gone, and the browser says so each time
    assert [
        words
        for words in opened.wrong
        if not (opened.outlives_its_mission and "WebSocket" in words)
    ] == []
    assert [
        url for url in opened.requests if not re.match(r"(file|data|(http|ws)://127\.0\.0\.1)", url)
    ] == []


@pytest.fixture
def shown(visits):
    """A report of the extended mission."""
    return visits.show(visits.file(report(recorded("suave_extended"))))


def slide(page, time):
    page.locator("#instant").evaluate(
        "(slider, t) => { slider.value = t;"
        " slider.dispatchEvent(new Event('input', {bubbles: true})) }",
        time,
    )
    settle(page)


def settle(page):
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => setTimeout(done)))")


def seen(page):
    """Return what each view shows, in words or as it is drawn."""
    return {
        "#scene": page.locator("#scene .robot").get_attribute("transform"),
        "#timelines": page.locator("#timelines .instant-line").get_attribute("style"),
        **{view: page.locator(view).inner_text() for view in ("#tree", "#knowledge", "#whatif")},
        "measured": page.locator("#timelines .measured").first.inner_text(),
        "clock": page.locator(".clock").inner_text(),
    }


def test_slider_moves_every_view(shown):
    slide(shown, 20)
    before = seen(shown)
    slide(shown, 160)
    after = seen(shown)
    assert {view for view in before if before[view] == after[view]} == set()
    slide(shown, 20)
    assert seen(shown) == before


def test_link_opens_the_same_instant_and_choice_again(shown, visits):
    shown.get_by_role("button", name=re.compile("battery_level is just below")).click()
    shown.locator("#knowledge").get_by_role("button", name="recharge", exact=False).first.click()
    sync_api.expect(shown).to_have_url(re.compile(r"#t=151(\.\d+)?&a=7&e=action\+recharge$"))
    assert seen(visits.show(shown.url)) == seen(shown)


def test_choosing_an_adaptation_moves_everything_and_draws_its_chain_through_all_views(shown):
    before = seen(shown)
    shown.get_by_role("button", name=re.compile("battery_level is just below")).click()
    settle(shown)
    after = seen(shown)
    assert {view for view in before if before[view] == after[view]} == set()
    assert after["clock"].startswith("151.0 s")
    chain = shown.locator(".chain").inner_text()
    expected = (
        "battery_level is just below 0.25",
        "inspect_pipeline unfeasible",
        "inspect_pipeline stopped",
    )
    places = [
        chain.index(words) for words in (*expected, "recharge requested", "stop follow_pipeline")
    ]
    assert places == sorted(places)
    assert shown.locator(".chain li").count() >= len(places)
    for marks in (
        "#tree .badge",
        "#knowledge .badge",
        "#timelines .badge",
        "#timelines .step-line",
        "#scene .steps",
    ):
        assert shown.locator(marks).count() > 0, marks


def test_steps_lead_to_the_next_change_and_the_next_adaptation(shown):
    slide(shown, 0)
    times = []
    for _ in range(3):
        shown.keyboard.press("n")
        times.append(shown.locator(".clock").inner_text().split(" s")[0])
    assert times == ["12.6", "23.6", "35.7"]
    shown.keyboard.press("p")
    assert shown.locator(".clock").inner_text().startswith("23.6 s")
    shown.keyboard.press("ArrowRight")
    assert float(shown.locator("#instant").input_value()) > 23.607


def test_moving_a_measurement_tells_what_would_be_chosen_and_of_which_instant_that_is(shown):
    slide(shown, 120)
    slider = shown.locator("#whatif label", has_text="battery_level").locator("input")
    slider.evaluate(
        "one => { one.value = 0.1; one.dispatchEvent(new Event('input', {bubbles: true})) }"
    )
    told = shown.locator("#whatif").inner_text()
    assert "If battery_level were below 0.25:" in told
    feasible = told.split("feasible then")[1].split("other statuses")[0]
    assert "recharge" in feasible
    assert "inspect_pipeline" not in feasible
    stored = float(re.search(r"stored at ([\d.]+) s", told)[1])
    assert 0 < stored <= 120


def test_element_says_why_what_would_help_and_what_the_alternatives_were(shown):
    slide(shown, 152)
    shown.locator("#knowledge").get_by_role("button", name="inspect_pipeline").click()
    details = shown.locator("#knowledge .details").inner_text()
    assert "inspect_pipeline is unfeasible because battery_level" in details
    assert "what would help" in details
    slide(shown, 30)
    shown.locator("#knowledge").get_by_role("button", name="spiral_search").click()
    details = shown.locator("#knowledge .details").inner_text()
    assert "not high_altitude" in details
    assert "spiral_altitude = 1" in details


def test_plan_is_listed_and_its_step_that_is_under_way_is_marked(visits):
    page = visits.show(visits.file(report(recorded("agv", "pddl"))))
    running = page.locator("#tree li[aria-current=step]")
    for time, step in ((5, "cross(cross_c1"), (30, "cross(cross_c4")):
        slide(page, time)
        assert [step in words for words in running.all_inner_texts()] == [True]


CUT = """() => [...document.querySelectorAll(
    "html, body *:not(.unseen, svg *, [role=tree] *, .lane *)")]
  .filter(one => one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0)
  .filter(one => one.tagName === "HTML" || getComputedStyle(one).overflowX !== "visible")
  .map(one => `${one.tagName}.${one.className} ${one.scrollWidth} > ${one.clientWidth}`)"""


@pytest.mark.parametrize(("mission", "task"), MISSIONS)
def test_nothing_is_cut_at_any_width(visits, mission, task):
    page = visits.show(visits.file(report(recorded(mission, task))))
    page.keyboard.press("p")
    for kind in ("Actions", "Functions", "Components"):
        group = page.locator("#knowledge h3", has_text=kind).locator("xpath=following-sibling::ul")
        group.get_by_role("button").first.click()
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            settle(page)
            assert page.evaluate(CUT) == [], width


def violations(page):
    """Return the violations of accessibility that axe-core finds in a page as it is now."""
    if not AXE.exists():
        pytest.skip("axe-core is not here: `npm ci` in missions/views/page installs it")
    page.evaluate(AXE.read_text(encoding="utf-8"))
    return page.evaluate(
        """() => axe.run().then(({ violations }) => violations.map(
            ({ id, nodes: [{ html, failureSummary }] }) => [id, html, failureSummary]))"""
    )


@pytest.mark.parametrize(("width", "scheme"), [(375, "dark"), (1440, "light")])
def test_report_has_no_violation_of_accessibility(visits, scheme, width):
    page = visits.show(visits.file(report(recorded("suave_extended"))), width, scheme=scheme)
    for tab in ("What if", "Events"):
        page.get_by_role("button", name=tab, exact=True).click()
        page.keyboard.press("n")
        page.locator("#knowledge li button").first.click()
        assert violations(page) == []
    page.keyboard.press("e")
    assert violations(page) == []


def test_keys_are_listed_by_a_key_and_let_nothing_through_until_they_are_closed(shown):
    listed, at = shown.get_by_role("dialog", name="keys"), shown.locator("#instant")
    shown.keyboard.press("End")
    shown.keyboard.type("?")
    assert listed.is_visible()
    before = at.input_value()
    shown.keyboard.press("Home")
    assert at.input_value() == before
    shown.keyboard.press("Escape")
    listed.wait_for(state="hidden")
    shown.keyboard.press("Home")
    sync_api.expect(at).to_have_value("0")


def test_keyboard_alone_reaches_and_works_everything(shown):
    def focused(of="e.getAttribute('aria-label') || e.textContent"):
        return shown.evaluate(f"() => {{ const e = document.activeElement; return {of} }}")

    reached = []
    for _ in range(200):
        shown.keyboard.press("Tab")
        if focused("e.tagName") == "BODY":
            break
        reached.append(focused())
    words = " | ".join(reached)
    for name in (
        "time limit",
        "dark",
        "keys",
        "battery_level is 1",
        "search the tree",
        "nodes of the tree",
    ):
        assert name in words, name
    for name in (
        "search what is known",
        "inspect_pipeline",
        "play",
        "next adaptation",
        "instant shown",
    ):
        assert name in words, name
    shown.keyboard.press("/")
    assert focused() == "search the tree"
    shown.keyboard.type("feasible?")
    assert shown.get_by_role("treeitem").filter(has_text="recharge feasible?").count() == 1
    for _ in range(6):
        shown.keyboard.press("Tab")
    assert focused() == "nodes of the tree"
    shown.keyboard.press("End")
    assert "recharge feasible?" in shown.locator("[role=treeitem][aria-selected=true]").inner_text()
    shown.keyboard.press("Escape")
    shown.keyboard.press("d")
    assert shown.evaluate("() => document.documentElement.dataset.theme") == "dark"


def test_panel_fills_the_page_and_goes_back_and_the_link_keeps_it(shown, visits):
    def height(page):
        return page.locator("#tree").bounding_box()["height"]

    small = height(shown)
    shown.locator("#tree .outline").focus()
    shown.keyboard.press("e")
    assert height(shown) > 2 * small
    assert not shown.locator("#scene").is_visible()
    shown.keyboard.press("Escape")
    assert height(shown) == pytest.approx(small, abs=120)  # the chain has left its room
    shown.get_by_role("button", name="Scene: change places with the next panel").click()
    shown.get_by_role("button", name="Tree · 14 nodes: fill the page").click()
    sync_api.expect(shown).to_have_url(re.compile("p=tree.*o=adaptations%2Ctree%2Cscene"))
    again = visits.show(shown.url)
    assert height(again) == height(shown)


def test_events_are_filtered_and_lead_to_their_instant(shown):
    shown.get_by_role("button", name="Events").click()
    entries = shown.locator("#log .entry")
    assert entries.count() > 50
    shown.get_by_label("least level").select_option("error")
    shown.get_by_label("search events").fill("thruster")
    told = entries.all_inner_texts()
    assert told
    assert all("error" in one and "thruster" in one for one in told)
    entries.first.click()
    assert shown.locator(".clock").inner_text().startswith(told[0].split(" s")[0])


def test_condition_leads_to_its_next_time_and_stops_the_playing(shown):
    slide(shown, 0)
    shown.get_by_role("button", name="Events").click()
    shown.get_by_label("condition, such as").fill("inspect_pipeline unfeasible")
    shown.get_by_role("button", name="Next time").click()
    assert shown.locator(".clock").inner_text().startswith("150.9 s")
    shown.get_by_role("button", name="Stop there").click()
    slide(shown, 149)
    shown.keyboard.press("Escape")
    shown.locator("#instant").focus()
    shown.keyboard.press("Space")
    sync_api.expect(shown.locator(".clock")).to_have_text(re.compile("^150.9 s"))
    shown.get_by_role("button", name="play (Space)").wait_for()
    shown.get_by_label("condition, such as").fill("nobody failed")
    assert "no such element" in shown.locator("#log").inner_text()


def test_curves_are_zoomed_by_dragging_read_and_downloaded(shown):
    plot = shown.locator("#timelines .plot").first
    box = plot.bounding_box()
    shown.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 20)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 20, steps=3)
    shown.mouse.up()
    sync_api.expect(shown).to_have_url(re.compile(r"z=\d+(\.\d+)?%2C\d+"))
    assert re.search(r"[\d.]+ at \d+", shown.locator("#timelines .reads").first.inner_text())
    with shown.expect_download() as started:
        shown.get_by_role("button", name="CSV").click()
    lines = Path(started.value.path()).read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith('"time [s]","water_visibility [m]","battery_level')
    times = [float(line.split(",")[0]) for line in lines[1:]]
    assert 80 < times[0] < times[-1] < 210
    shown.keyboard.press("z")
    sync_api.expect(shown).not_to_have_url(re.compile("z="))


def test_adaptations_are_told_to_screen_readers(shown):
    slide(shown, 152)
    told = shown.locator("p[aria-live]").inner_text()
    assert told.startswith(
        "Adaptation at 151.0 s: battery_level is just below 0.25; inspect_pipeline -> recharge"
    )


def page_with(rows):
    """Return a page of a run of which only these rows are known, in the order of their times."""
    run = {
        "header": recorded("suave_extended").header,
        "rows": sorted(rows, key=lambda row: row[0]),
    }
    return page_of({"run": run, "live": None, "note": ""}, "by hand")


def tree_of(count):
    """Return a report whose tree has that many nodes, all of which change at the second instant."""
    nodes = [[0, None, "Sequence", "root", "sequence", []]]
    nodes += [
        [uid, (uid - 1) // 5, "Action", f"node {uid}", "action", []] for uid in range(1, count)
    ]
    rows = [
        [0.0, "tree", 0, {"name": "large", "nodes": nodes}],
        [0.0, "tick", 0, 0],
        [3.0, "now", 0, "end"],
    ]
    rows += [
        [t, "node", uid, ["RSF"[(uid + int(t)) % 3], ""]]
        for t in (0.0, 1.0, 2.0)
        for uid in range(count)
    ]
    return page_with(rows)


def test_robot_whose_clock_counts_from_1970_is_shown_the_time_of_day(visits):
    day = 1_700_000_000.0
    rows = [
        [day, "scene", 0, []],
        [day + 60, "signal", "depth [m]", 2.0],
        [day + 60, "now", 0, "end"],
    ]
    page = visits.show(visits.file(page_with(rows)))
    assert page.locator(".clock").inner_text().startswith("22:14:20.0 UTC")
    page.keyboard.press("Home")
    assert page.locator(".clock").inner_text().startswith("22:13:20.0 UTC")


def test_tree_of_a_thousand_nodes_makes_only_what_is_in_sight(visits):
    page = visits.show(visits.file(tree_of(1000)))
    assert page.locator("#tree h2").inner_text().endswith("1000 NODES")
    assert 0 < page.get_by_role("treeitem").count() < 100
    page.locator(".outline").focus()
    page.keyboard.press("End")
    assert (
        page.locator("[role=treeitem][aria-selected=true]").get_attribute("aria-posinset") == "1000"
    )
    page.get_by_label("search the tree").fill("node 777")
    assert page.get_by_role("treeitem").last.inner_text().strip().endswith("node 777")
    page.get_by_role("button", name="Drawn").click()
    assert page.get_by_role("img", name=re.compile("1000 nodes")).bounding_box()["height"] > 100


def test_tree_that_changed_is_shown_as_it_was(visits):
    root = [0, None, "Sequence", "root", "sequence", []]
    step = [1, 0, "Action", "old step", "action", []]
    changed = [
        root,
        step,
        [2, 0, "Plan", "new plan", "plan", []],
        [3, 2, "Action", "new step", "action", []],
    ]
    rows = [
        [0.0, "tree", 0, {"name": "", "nodes": [root, step]}],
        [0.0, "node", 1, ["R", "begins"]],
    ]
    rows += [
        [5.0, "tree", 0, {"name": "", "nodes": changed}],
        [5.0, "node", 1, ["S", ""]],
        [9.0, "now", 0, "end"],
    ]
    page = visits.show(visits.file(page_with(rows)))
    assert page.get_by_role("treeitem").count() == len(changed)
    slide(page, 4.9)
    assert [text.split()[-3:] for text in page.get_by_role("treeitem").all_inner_texts()][1] == [
        "old",
        "step",
        "begins",
    ]
    assert page.get_by_role("treeitem").count() == len([root, step])


def test_actions_that_are_done_at_the_same_time_have_a_lane_each(visits):
    action = {"kind": "action", "requires": [], "constraints": []}
    rows = [
        [0.0, "element", key, {**action, "name": name}]
        for key, name in enumerate(("drive", "film"))
    ]
    for key, start in ((0, 1.0), (1, 2.0)):
        rows.append(
            [
                start,
                "action",
                key,
                {"action": key, "start": start, "end": 5.0, "result": "completed"},
            ]
        )
    page = visits.show(visits.file(page_with([*rows, [9.0, "now", 0, "end"]])))
    assert page.locator(".lane .name").all_inner_texts() == ["action drive", "action film"]


def test_report_that_a_live_view_wrote_claims_no_knowledge_base_to_ask(visits):
    header = recorded("suave_extended").header | {"manager": ""}
    run = {"header": header, "rows": recorded("suave_extended").rows}
    text = page_of({"run": run, "live": None, "note": "cut off at 300 s"}, "live")
    page = visits.show(visits.file(text))
    assert "Cases stored at" in page.locator("#whatif").inner_text()
    assert "manager" not in page.locator(".head").inner_text()
    assert page.get_by_role("alert").inner_text() == "cut off at 300 s"


@pytest.fixture
def running(tmp_path):
    """The extended mission, while it runs."""
    command = [
        "run",
        "suave_extended",
        "--live",
        "0",
        "--allow-control",
        "--speed",
        "0.5",
        "--no-progress",
    ]
    program = [sys.executable, "-m", "missions", *command]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    yield process
    process.kill()
    process.communicate()


@pytest.fixture
def address(running):
    return re.search(r"http://\S+", running.stdout.readline())[0]


def test_fault_is_injected_and_the_adaptation_and_its_chain_stand_there(
    address, visits
):  # the page goes first
    page = visits.show(address)
    page.locator(".connection", has_text="connected").wait_for()
    slider = page.locator("#whatif label", has_text="battery_level").locator("input")
    slider.wait_for()
    slider.evaluate(
        "one => { one.value = 0.1; one.dispatchEvent(new Event('input', {bubbles: true})) }"
    )
    page.locator("#whatif", has_text="feasible then").wait_for()
    page.get_by_role("button", name="Disturb").click()
    page.get_by_label("value of battery_level").fill("0.1")
    page.locator("#disturb li", has_text="battery_level").get_by_role(
        "button", name="Measure"
    ).click()
    adapted = page.locator("#adaptations li button", has_text="search_pipeline → recharge")
    adapted.click()
    sync_api.expect(page).to_have_url(
        re.compile("#t=.*a=")
    )  # it is the first, unless the page was slow to come
    for words in (
        "battery_level 0.",
        "search_pipeline unfeasible",
        "search_pipeline stopped",
        "recharge requested",
    ):
        assert words in page.locator(".chain").inner_text()
    page.locator(".chain", has_text="in force").wait_for()
    page.get_by_role("button", name="Pause mission").click()
    page.locator(".connection", has_text="paused").wait_for()
    page.get_by_role("button", name="Resume mission").click()
    page.get_by_role("button", name="Now", exact=True).click()
    sync_api.expect(page.get_by_role("button", name="Now", exact=True)).to_have_attribute(
        "aria-pressed", "true"
    )
    assert page.locator("#instant").evaluate("one => one.value === one.max")


def test_what_if_changes_no_fact_in_a_live_mission(visits):
    with mission("pause", speed=0, duration=20) as (view, run, _, steering):
        page = visits.show(view.url)
        visits.outlives_its_mission = True
        known = repr(run.kb.components), repr(run.kb.attributes), run.kb.log.last
        for component in ("c_thruster_1", "spiral_search"):
            page.locator("#whatif").get_by_role("button", name=f"{component} failed").click()
        outcome = page.locator("#whatif .details", has_text="other statuses")
        outcome.get_by_text("c_thruster_1").wait_for()
        assert (repr(run.kb.components), repr(run.kb.attributes), run.kb.log.last) == known
        assert not run.faults.injected
        page.get_by_role("button", name="Disturb").click()
        assert violations(page) == []
        page.locator("#disturb li", has_text="c_thruster_1").get_by_role(
            "button", name="Fail"
        ).click()
        steering.do({"do": "step"})
        page.get_by_role("button", name="Events").click()
        page.locator(".entry.error", has_text="c_thruster_1 has failed").wait_for()
        assert run.kb.components["c_thruster_1"].status == "failure"


def test_live_mission_stops_at_a_breakpoint_set_on_the_page(visits):
    with mission("pause", speed=0, duration=40) as (view, run, *_):
        page = visits.show(view.url)
        visits.outlives_its_mission = True
        page.get_by_role("button", name="Events").click()
        page.get_by_label("condition, such as").fill("water_visibility < 3")
        page.get_by_role("button", name="Stop there").click()
        page.locator(".stop", has_text="water_visibility < 3").wait_for()
        page.get_by_role("button", name="Resume mission").click()
        page.locator(".connection", has_text="paused: water_visibility < 3 at").wait_for()
        assert 2.8 < run.kb.attributes["water_visibility"].value < 3


def test_page_says_that_the_mission_is_gone(visits, running, address):
    page = visits.show(address)
    page.locator(".connection", has_text="connected").wait_for()
    visits.outlives_its_mission = True
    running.kill()
    page.locator(".connection", has_text="lost").wait_for()


def test_page_goes_on_showing_the_run_after_it_is_over(visits):
    """It looks from before the end on, so that the result comes to a page that has been drawn."""
    with mission("pause", speed=0, duration=20) as (view, _, done, steering):
        page = visits.show(view.url)
        page.locator(".connection", has_text="connected").wait_for()
        assert not done
        visits.outlives_its_mission = True
        steering.do({"do": "resume"})
        page.locator("summary", has_text=re.compile("not.found")).wait_for()
