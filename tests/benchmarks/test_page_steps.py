"""What a step of the page's slider costs with a tree of 1,000 nodes, beside one of ten."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "missions"))
from test_page_in_browser import browser, pytestmark, tree_of, visits  # noqa: F401  # its fixtures are used here

pytestmark = [pytestmark, pytest.mark.benchmark]  # skipped where there is no chromium
STEPS = 100
STEP = """async (steps) => {
  const slider = document.getElementById("instant");
  for (let step = 1; step <= steps; step += 1) {
    slider.value = 2.9 * (step % 2) + 0.01;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  }
}"""


def step_s(page):
    """Return the processor's time of a step, drawn to the end [s], the least of three rounds."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent():
        metrics = session.send("Performance.getMetrics")["metrics"]
        return next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration")

    rounds = []
    for _ in range(3):
        before = spent()
        page.evaluate(STEP, STEPS)
        rounds.append((spent() - before) / STEPS)
    return min(rounds)


def test_step_with_a_thousand_nodes_costs_little_more(visits):  # noqa: F811  # the fixture
    small, large = (step_s(visits.show(visits.file(tree_of(count)))) for count in (10, 1000))
    print(f"\na step: {1000 * small:.1f} ms with 10 nodes, {1000 * large:.1f} ms with 1,000")
    assert large < 3 * small
