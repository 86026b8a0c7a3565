"""The engine as those have it who plan with unified-planning itself."""

from fractions import Fraction

import pytest
from unified_planning import shortcuts as up

from rosa_pddl import register_engine

ROADS = {
    ("Home", "Hall"): Fraction(1, 3),
    ("Hall", "Dock"): Fraction(1, 3),
    ("Home", "Dock"): Fraction(3, 4),
}


class Trip:
    """From home to the dock: through the hall for two thirds, or more steeply for three quarters."""

    def __init__(self):
        place = up.UserType("Place")
        self.at, self.road = (
            up.Fluent("At", up.BoolType(), p=place),
            up.Fluent("road", up.BoolType(), a=place, b=place),
        )
        self.takes = up.Fluent("takes", up.RealType(), a=place, b=place)
        self.used = up.Fluent("energy", up.RealType())
        self.problem = up.Problem("trip")
        for fluent, value in (
            (self.at, False),
            (self.road, False),
            (self.takes, 0),
            (self.used, 0),
        ):
            self.problem.add_fluent(fluent, default_initial_value=value)
        self.places = {
            name: self.problem.add_object(name, place) for name in ("Home", "Hall", "Dock")
        }
        self.go = up.InstantaneousAction("go", a=place, b=place)
        self.go.add_precondition(up.And(self.at(self.go.a), self.road(self.go.a, self.go.b)))
        self.go.add_effect(self.at(self.go.a), False)
        self.go.add_effect(self.at(self.go.b), True)
        self.go.add_increase_effect(self.used, self.takes(self.go.a, self.go.b))
        self.problem.add_action(self.go)
        for (start, end), share in ROADS.items():
            self.problem.set_initial_value(self.road(self.places[start], self.places[end]), True)
            self.problem.set_initial_value(self.takes(self.places[start], self.places[end]), share)
        self.problem.set_initial_value(self.at(self.places["Home"]), True)
        self.problem.add_goal(self.at(self.places["Dock"]))
        self.problem.add_quality_metric(up.MinimizeActionCosts({self.go: up.Int(1)}))

    def solved(self, **options):
        with up.OneshotPlanner(name="label-setting") as planner:
            return planner.solve(self.problem, **options)

    def refusal(self):
        result = self.solved()
        assert (result.status.name, result.plan) == ("UNSUPPORTED_PROBLEM", None)
        return result.log_messages[0].message


@pytest.fixture
def trip():
    up.get_environment().credits_stream = None
    register_engine()
    register_engine()
    return Trip()


def test_it_is_found_by_name_and_by_what_it_can_do(trip):
    assert [str(step) for step in trip.solved().plan.actions] == ["go(Home, Dock)"]
    trip.problem.add_goal(up.LE(trip.used, 1))
    kind, guarantee = trip.problem.kind, up.OptimalityGuarantee.SOLVED_OPTIMALLY
    with up.OneshotPlanner(problem_kind=kind, optimality_guarantee=guarantee) as planner:
        assert planner.name == "label-setting"


def test_thirds_are_exact_and_the_problem_stays_as_it_is(trip):
    trip.problem.add_goal(up.LE(trip.used, Fraction(2, 3)))
    before = trip.problem.clone()
    result = trip.solved(timeout=300.0)
    assert result.status.name == "SOLVED_OPTIMALLY"
    assert [str(step) for step in result.plan.actions] == ["go(Home, Hall)", "go(Hall, Dock)"]
    assert trip.problem == before
    with up.PlanValidator(problem_kind=trip.problem.kind, plan_kind=result.plan.kind) as validator:
        assert validator.validate(trip.problem, result.plan)
    trip.problem.add_goal(up.LT(trip.used, Fraction(2, 3)))
    result = trip.solved()
    assert (result.status.name, result.plan) == ("UNSOLVABLE_PROVEN", None)


def test_it_is_out_of_time_when_it_is(trip):
    assert trip.solved(timeout=1e-9).status.name == "TIMEOUT"


def test_conditions_on_numbers_are_kept(trip):
    trip.go.add_precondition(up.GT(trip.takes(trip.go.a, trip.go.b), 10))
    assert trip.solved().status.name == "UNSOLVABLE_PROVEN"


@pytest.mark.parametrize("least", [0, Fraction(1, 2)])
def test_a_goal_may_ask_for_at_least_so_much(trip, least):
    trip.problem.add_goal(up.GE(trip.used, least))
    result = trip.solved()
    with up.PlanValidator(problem_kind=trip.problem.kind, plan_kind=result.plan.kind) as validator:
        assert validator.validate(trip.problem, result.plan)


@pytest.mark.parametrize("change", ["add_increase_effect", "add_effect"])
def test_what_a_step_takes_may_be_changed_by_steps(trip, change):
    getattr(trip.go, change)(trip.takes(trip.go.b, trip.go.a), 1)
    trip.problem.add_goal(up.Equals(trip.takes(trip.places["Hall"], trip.places["Home"]), 1))
    assert [str(step) for step in trip.solved().plan.actions] == [
        "go(Home, Hall)",
        "go(Hall, Dock)",
    ]


def test_what_a_step_costs_may_be_changed_by_steps(trip):
    trip.problem.clear_quality_metrics()
    trip.problem.add_quality_metric(up.MinimizeActionCosts({trip.go: trip.used()}))
    assert [str(step) for step in trip.solved().plan.actions] == ["go(Home, Dock)"]
    trip.go.clear_effects()
    trip.go.add_effect(trip.at(trip.go.a), False)
    trip.go.add_effect(trip.at(trip.go.b), True)
    trip.go.add_effect(trip.used, trip.takes(trip.go.a, trip.go.b))
    trip.problem.add_goal(up.Equals(trip.used, Fraction(1, 3)))
    assert [str(step) for step in trip.solved().plan.actions] == [
        "go(Home, Hall)",
        "go(Hall, Dock)",
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("dock", "the object 'Dock', expected a name of letters"),
        ("my place", "'my place', expected a name"),
    ],
)
def test_names_that_pddl_cannot_tell_apart_or_does_not_have_are_refused(trip, name, words):
    trip.problem.add_object(name, trip.problem.user_type("Place"))
    assert words in trip.refusal()


def test_several_uses_of_one_action_add_up(trip):
    trip.go.add_increase_effect(trip.used, 1)
    trip.problem.add_goal(up.LE(trip.used, Fraction(7, 4)))
    assert [str(step) for step in trip.solved().plan.actions] == ["go(Home, Dock)"]
    trip.problem.add_goal(up.LT(trip.used, Fraction(7, 4)))
    assert trip.solved().status.name == "UNSOLVABLE_PROVEN"


@pytest.mark.filterwarnings("ignore:.*cannot.*")  # unified-planning warns, and asks all the same
def test_what_it_does_not_know_is_refused_rather_than_passed_over(trip):
    battery = up.Fluent("battery", up.IntType(0, 3))
    trip.problem.add_fluent(battery, default_initial_value=0)
    trip.go.add_increase_effect(battery, 2)
    assert "bounded_types" in trip.refusal()
    other = Trip()
    other.problem.clear_quality_metrics()
    other.problem.add_quality_metric(up.MaximizeExpressionOnFinalState(other.used()))
    assert other.refusal() == "label-setting does not support final_value"
