"""Events on the same robot told to the knowledge base and to others that know the same rules; all have to agree."""

import shutil
from functools import cache
from importlib import import_module
from statistics import median
from time import perf_counter

import pytest
from figures import shown, table
from generated import at_work, robot, story, tell
from naive_peers import facts, views

KINDS = ("measured", "failed", "active", "requested", "selected")
EVENTS = 40
OURS = "knowledge base"
PEERS = {
    OURS: None,
    "naive twin": ("naive_peers", "NaivePeer"),
    "naive twin, indexed": ("naive_peers", "IndexedPeer"),
    "clingo, solved again": ("answer_sets", "MultiShot"),
    "clingo, grounded again": ("answer_sets", "Grounded"),
    "owlready2, SPARQL": ("ontology", "SparqlPeer"),
}
COUNTS = {(1_000, "naive twin"): 5, (10_000, "owlready2, SPARQL"): 10}
"""Fewer events where an event takes long."""
NOT_RUN = (10_000, "naive twin")
CASES = [(size, name) for size in (100, 1_000, 10_000) for name in PEERS if (size, name) != NOT_RUN]
LIBRARIES = {"answer_sets": "clingo", "ontology": "owlready2"}


class Ours:
    """The knowledge base as one of the peers."""

    def __init__(self, kb):
        self.kb = kb
        self.views = views(kb)

    def tell(self, happening):
        tell(self.kb, happening)

    def statuses(self):
        return {key: str(view.status) for key, view in self.views.items()}


@cache
def told(size):
    """Return what happens; what the knowledge base refuses does not happen to the others either."""
    kb = at_work(robot(size))
    return [
        happening
        for happening in story(KINDS, size, EVENTS, seed=4, overlap=3)
        if tell(kb, happening)
    ]


def peer(name, size):
    kb = at_work(robot(size))
    if name == OURS:
        return Ours(kb)
    module, kind = PEERS[name]
    if module in LIBRARIES:
        pytest.importorskip(LIBRARIES[module])
    return getattr(import_module(module), kind)(kb.model, list(facts(kb)))


@pytest.fixture(scope="module")
def medians(tables):
    found = {}
    tables["3"] = lambda: written(found)
    return found


def written(found):
    sizes = sorted({size for size, _ in found})

    def cell(size, name):
        if (size, name) not in found:
            return None
        ratio = (
            f" ({found[size, name] / found[size, OURS]:.0f}x)"
            if (size, OURS) in found and name != OURS
            else ""
        )
        return shown(found[size, name]) + ratio

    head = (
        "one event, all statuses known again; p50 (ratio to ours)",
        *(f"{size:,} elements" for size in sizes),
    )
    names = [name for name in PEERS if any((size, name) in found for size in sizes)]
    return table("Peers", head, [(name, *(cell(size, name) for size in sizes)) for name in names])


@pytest.mark.parametrize(("size", "name"), CASES, ids=lambda value: str(value))
@pytest.mark.benchmark
def test_peer_agrees_after_every_event(size, name, benchmark, medians):
    happenings = told(size)[: COUNTS.get((size, name), EVENTS)]
    benchmark.group = f"one event among {size:,} elements"
    one, left = peer(name, size), iter(happenings)
    benchmark.pedantic(one.tell, setup=lambda: ((next(left),), {}), rounds=len(happenings))
    medians[size, name] = median(benchmark.stats.stats.data)
    ours, one = (
        peer(OURS, size),
        peer(name, size),
    )  # reading all statuses empties the caches: not while it is timed
    for happening in happenings:
        ours.tell(happening)
        one.tell(happening)
        assert one.statuses() == ours.statuses(), happening


@pytest.mark.benchmark
def test_reasoner_finds_the_same_unfeasible(tables):
    pytest.importorskip("owlready2")
    if not shutil.which("java"):
        pytest.skip("HermiT runs on Java, and there is none here")
    from reasoner import Reasoned

    ours, times, met = peer(OURS, 100), [], set()
    for happening in story(("measured", "failed"), 100, 6, seed=4, overlap=3):
        ours.tell(happening)
        statuses = ours.statuses()
        reasoned = Reasoned(
            ours.kb.model,
            [name for (_, name), status in statuses.items() if status == "violated"],
            [name for (_, name), status in statuses.items() if status == "failure"],
        )
        start = perf_counter()
        reasoned.classify()
        times.append(perf_counter() - start)
        unfeasible = {
            key for key, status in statuses.items() if status in ("unfeasible", "failure")
        }
        assert reasoned.unfeasible() == unfeasible
        met |= unfeasible
    assert met
    line = ("what is unfeasible, classified by HermiT (Java start included)", shown(median(times)))
    tables["4"] = lambda: table("For the record", ("100 elements", "p50"), [line])
