"""How the time for a joint plan grows with the building, and a picture of it."""

from pathlib import Path

from agv_worlds import generated_building
from figures import percentiles
from joint_peers import Robot, by_axioms, generate_and_test
from joint_questions import MODEL, asked, cold, known, timed
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.random import default_rng

from missions.agv.joint import JointPlanner, Question

SIZES = ((58, 70), (125, 150), (250, 300), (500, 600), (1000, 1200))
QUESTIONS = 20
AXIOMS = {58: 3, 125: 2, 250: 2}
"""How often Fast Downward is asked at each size; it is slow beyond."""

Points = dict[int, tuple[float, float]]
WAYS = {
    "joint plan, cold": "#7f7f7f",
    "joint plan, warm": "#1f77b4",
    "joint plan, within a budget of energy": "#2ca02c",
    "generate and test, 10 shortest ways or 20,000 trials": "#9467bd",
    "PDDL axioms, Fast Downward": "#d62728",
}


def grown(folder: Path) -> dict[str, Points]:
    """Return the median and what 90 of 100 stay below [s], by number of places, for each way to plan."""
    times: dict[str, dict[int, list[float]]] = {way: {} for way in WAYS}
    for places, corridors in SIZES:
        rng = default_rng(places)
        building = generated_building(rng, places, corridors)
        planner = JointPlanner(building, known())
        planner.plan(Question())
        joint_cold, warm, within, tested, axioms = ([] for _ in WAYS)
        for number in range(QUESTIONS):
            question = asked(rng, building)
            took, answer = timed(planner.plan, question)
            warm.append(took)
            if number < 10:
                joint_cold.append(timed(cold, building, question, ())[0])
                tested.append(timed(generate_and_test, planner.task(question))[0])
            if number < AXIOMS.get(places, 0):
                axioms.append(timed(by_axioms, Robot(building, MODEL, ()), question, folder)[0])
            if answer.is_solved:
                budget = {"energy": 1.1 * answer.takes.in_units["energy"]}
                within.append(
                    timed(
                        planner.plan,
                        Question(question.start, question.goal, question.weights, budget),
                    )[0]
                )
        for way, some in zip(WAYS, (joint_cold, warm, within, tested, axioms), strict=True):
            times[way][places] = some
    return {
        way: {places: percentiles(some)[:2] for places, some in by_size.items() if some}
        for way, by_size in times.items()
    }


def drawn(measured: dict[str, Points], path: Path, published_s: float) -> None:
    """Draw medians over the number of places, with a band up to what 90 of 100 stay below."""
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for way, points in measured.items():
        sizes, colour = sorted(points), WAYS[way]
        medians, ninety = ([points[one][part] for one in sizes] for part in (0, 1))
        axes.plot(sizes, medians, "o-", color=colour, label=way, markersize=4)
        axes.fill_between(sizes, medians, ninety, color=colour, alpha=0.15, linewidth=0)
    axes.plot([58], [published_s], "k*", markersize=11)
    words = f"published: {published_s} s on average,\non another machine"
    axes.annotate(
        words,
        (58, published_s),
        xytext=(10, -4),
        textcoords="offset points",
        va="center",
        fontsize=9,
    )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="places",
        ylabel="time for a plan [s]",
        xlim=(50, 1150),
        ylim=(5e-4, 50),
    )
    axes.set_xticks([places for places, _ in SIZES])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8, loc="upper right", bbox_to_anchor=(1.0, 0.99))
    figure.savefig(path, dpi=150)
