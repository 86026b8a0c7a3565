import pytest
from pddl_world import ROOMS_DOMAIN, ROOMS_PROBLEM, load_mission, load_text


@pytest.fixture(scope="session")
def extended():
    return load_mission("suave_extended")


@pytest.fixture(scope="session")
def rooms(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("rooms"), ROOMS_DOMAIN, ROOMS_PROBLEM)
