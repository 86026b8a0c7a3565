"""The page in a real browser: a battery fault is injected from it, and the adaptation stands there with its chain."""

import re
import time

from browsing import needs_browser, visiting
from test_live import mission
from test_page import recorded

from missions.views.report import write_report
from missions.views.steering import Steering

pytestmark = needs_browser


def test_battery_fault_injected_from_the_page_stands_there_with_its_chain():
    with mission(Steering(speed=0.5), duration=60) as (view, run, _), visiting(view.url) as visit:
        page = visit.page
        page.get_by_text("search_pipeline").first.wait_for()
        battery = page.locator("label", has_text="battery_level").locator("input[type=range]")
        battery.evaluate("one => { one.value = 0.1; one.dispatchEvent(new Event('input', {bubbles: true})) }")
        page.get_by_role("button", name="Measure this from now on").click()
        page.get_by_text(re.compile(r"search_pipeline (→|->) recharge")).first.click()
        for words in ("battery_level 0.", "search_pipeline stopped", "recharge requested", "in force"):
            page.get_by_text(words).first.wait_for()
        page.wait_for_url(re.compile("#t=.*a=1"))
        assert run.adaptations[0].action == "recharge"
        assert visit.elsewhere(view.url, view.url.replace("http", "ws")) == []
        assert visit.said == []


def test_link_opens_the_same_instant_of_a_report_and_asks_nothing_of_any_network(tmp_path):
    run, _ = recorded()
    write_report(tmp_path / "run.html", run)
    url = (tmp_path / "run.html").as_uri()
    with visiting(f"{url}#t=151.0&a=7") as visit:
        page = visit.page
        for words in ("recharge requested", "inspect_pipeline stopped"):
            page.get_by_text(words).first.wait_for()
        shown = page.locator("body").inner_text()
        assert "151.0 s" in shown
        visit.page.keyboard.press("Home")
        page.reload()
        assert visit.elsewhere(url) == []
        assert visit.said == []


def test_page_goes_on_showing_the_run_after_it_is_over():
    with mission(Steering(speed=50), duration=20) as (view, _, done), visiting(view.url) as visit:
        while not done:
            time.sleep(0.05)
        visit.page.locator("summary", has_text=re.compile("not.found")).wait_for()
        assert [one for one in visit.said if "WebSocket" not in one] == []
