"""The built page is that of its sources: it carries their hash."""

import json
import re
import shutil
import subprocess
from hashlib import sha256
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "missions" / "views" / "page"
BUILT = ("page.css", "page.js")
MOST_LINES, LONGEST_LINE = 2_300, 140


def sources():
    own = sorted(path for path in (PAGE / "src").iterdir() if path.is_file())
    assert len(own) > 10
    return [PAGE / "build.mjs", PAGE / "package-lock.json", PAGE / "package.json", *own]


@pytest.mark.parametrize("name", BUILT)
def test_bundle_carries_the_hash_of_its_sources(name):
    found = sha256()
    for path in sources():
        found.update(
            f"{path.relative_to(PAGE).as_posix()}\0{path.read_text(encoding='utf-8')}\0".encode()
        )
    said = re.match(r"/\*! sources (\w{64})\b", (PAGE / "dist" / name).read_text(encoding="utf-8"))
    assert said, name
    assert said[1] == found.hexdigest(), (
        "the sources have changed since the page was built: run `make page`"
    )


def test_building_again_gives_the_same_bytes(tmp_path):
    if not shutil.which("node") or not (PAGE / "node_modules").is_dir():
        pytest.skip("node, or what `npm ci` installs, is not here")
    for path in (*sources(), PAGE / "node_modules"):
        place = tmp_path / path.relative_to(PAGE)
        place.parent.mkdir(exist_ok=True)
        place.symlink_to(path)
    subprocess.run(
        ["node", "--preserve-symlinks-main", "build.mjs"], cwd=tmp_path, check=True, timeout=200
    )
    for name in BUILT:
        assert (tmp_path / "dist" / name).read_bytes() == (PAGE / "dist" / name).read_bytes()


def test_lock_names_no_place_to_download_from_and_pins_everything():
    lock = json.loads((PAGE / "package-lock.json").read_text())
    assert len(lock["packages"]) > 5
    for name, one in lock["packages"].items():
        assert "resolved" not in one, name
        assert not name or one["integrity"].startswith("sha512-"), name
    given = json.loads((PAGE / "package.json").read_text())
    for name, version in {**given["dependencies"], **given["devDependencies"]}.items():
        assert re.fullmatch(r"[\d.]+", version), name


def test_bundle_carries_the_licences_of_what_is_in_it():
    text = (PAGE / "dist" / "page.js").read_text(encoding="utf-8")
    for name in json.loads((PAGE / "package.json").read_text())["dependencies"]:
        assert f"{name}: " in text
    assert text.count("Copyright") >= len(BUILT)


def test_front_end_keeps_within_its_budget():
    files = {
        path: path.read_text(encoding="utf-8").splitlines() for path in (PAGE / "src").iterdir()
    }
    assert 0 < sum(map(len, files.values())) <= MOST_LINES, (
        "before you add, look what it makes superfluous"
    )
    for path, lines in files.items():
        if path.suffix in (".js", ".jsx", ".mjs"):
            assert max(map(len, lines)) <= LONGEST_LINE, path


def test_bundle_can_stand_inside_a_script_element():
    for name in BUILT:
        assert "</script" not in (PAGE / "dist" / name).read_text(encoding="utf-8").lower()


def test_page_that_is_open_for_days_lets_go_of_what_is_old_but_not_of_what_holds():
    if not shutil.which("node"):
        pytest.skip("node is not here")
    program = f"""
        import {{ Run }} from "{(PAGE / "src" / "run.js").as_uri()}";
        const run = new Run({{ header: {{}}, rows: [[0, "status", 0, "feasible"]] }}, 200_000);
        run.add([[0, "action", 1, {{ end: null }}], [1, "adaptation", 1, {{ t: 1 }}]]);
        for (let i = 0; i < 1_000_000; i += 1) run.add([[i / 10, "value", 0, i]]);
        const held = ["status", "value"].map((track) => run.of(track, 0).at(run.start));
        const count = run.of("value", 0).times.length;
const kept = [count, run.last("adaptation").length, run.keys("action")];
        console.log(JSON.stringify([...kept, held]));
    """
    done = subprocess.run(
        ["node", "--input-type=module", "-e", program], capture_output=True, text=True, check=True
    )
    kept, adaptations, actions, (status, value) = json.loads(done.stdout)
    assert 100_000 <= kept <= 200_001
    assert (adaptations, actions, status) == (0, ["1"], "feasible")
    assert value > 0
