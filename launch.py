#!/usr/bin/env python3
"""Set up .venv beside this file when it is missing or out of date, then run a command in it.

    python3 launch.py rosa run suave_extended
    python3 launch.py pytest

It installs what the command needs: for `rosa` and `python` what running needs, with the extras for
its options; for any other command what testing needs, too. Needs nothing but Python >= 3.11 and
pip. The versions installed are those of constraints.txt.
"""

import hashlib
import os
import re
import subprocess
import sys
import time
import venv
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
MARK = VENV / "set-up-for"
PYTHON = {"optimal", "plot", "sim"}
TESTING = "dev"
EXTRAS = {
    **dict.fromkeys(("suave", "suave_extended", "agv", "uav", "campaign"), "sim"),
    **{"--plot": "plot", "report": "plot", "--reason": "reason"},
    **{
        "--live": "live",
        "--tui": "tui",
        "--groot2": "groot2",
        "mcp": "mcp",
        "bridge": "ros2",
    },
    **{"replay": "mcap", "record": "mcap", "--cluster": "cluster"},
}
"""The extra that each word of a `rosa` command line needs; a file that ends in .mcap needs one,
too."""
STEP = re.compile(r"\s*(Collecting|Building|Preparing|Installing)\b[^(]{0,60}")


def extras(arguments: list[str]) -> set[str]:
    """Return the extras that a command needs.

    For other commands than `rosa` and `python` that of the tests.
    """
    if arguments[0] not in ("rosa", "python"):
        return {TESTING}
    words = [argument.partition("=")[0] for argument in arguments[1:]]
    mcap = {"mcap"} if any(argument.endswith(".mcap") for argument in arguments) else set()
    return (
        (PYTHON if arguments[0] == "python" else set())
        | mcap
        | {EXTRAS[word] for word in words if word in EXTRAS}
    )


def set_up(wished: set[str]) -> None:
    """Make the virtual environment and install this project in it.

    If that fails, the next call does it again.
    """
    try:
        inputs = b"".join(
            (ROOT / name).read_bytes()
            for name in ("pyproject.toml", "constraints.txt", "launch.py")
        )
    except OSError as error:
        sys.exit(
            f"launch.py: cannot read {error.filename}: {error.strerror}; "
            "get it back from the repository"
        )
    wanted = hashlib.sha256(inputs + sys.version.encode()).hexdigest()
    there = MARK.read_text().split() if MARK.is_file() and (BIN / "python").exists() else []
    keeps = there[:1] == [wanted]
    if keeps and (TESTING in there or wished <= set(there)):
        return
    if VENV.exists() and not VENV.is_dir():
        sys.exit(
            f"launch.py: {VENV} is in the way; it has to be a folder, "
            "so move it elsewhere and run this again"
        )
    # measured on two cores with a near package index
    needs, takes = ("testing", "about a minute") if TESTING in wished else ("running", "about 20 s")
    print(
        f"Setting up .venv with what {needs} needs: once, {takes}, "
        "longer where the network is slow",
        file=sys.stderr,
        flush=True,
    )
    python = str(BIN / "python")
    if find_spec("pip"):  # use the pip of this Python, so that ensurepip is not needed
        if not keeps:
            venv.create(VENV, clear=VENV.exists(), with_pip=False)
        pip = [sys.executable, "-m", "pip", "--python", python]
    elif find_spec("ensurepip"):
        if not keeps:
            venv.create(VENV, clear=VENV.exists(), with_pip=True)
        pip = [python, "-m", "pip"]
    else:
        sys.exit(
            "launch.py: this Python has no pip; install it (Debian: apt-get install python3-pip)"
        )
    chosen = sorted(wished.union(there[1:]) if keeps else wished)
    install(pip, f"{ROOT}[{','.join(chosen)}]" if chosen else str(ROOT))
    MARK.write_text(" ".join([wanted, *chosen]))


def install(pip: list[str], project: str) -> None:
    """Install the project with pip, showing its progress on one line.

    Errors of pip are shown in full.
    """
    constraints = str(ROOT / "constraints.txt")
    # modules are compiled when they are imported; most never are
    arguments = [
        "install",
        "--no-compile",
        "--disable-pip-version-check",
        "-c",
        constraints,
        "-e",
        project,
    ]
    started = time.monotonic()
    shows = sys.stderr.isatty()
    with subprocess.Popen(
        [*pip, *arguments],
        env={**os.environ, "PIP_CONSTRAINT": constraints, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            step = STEP.match(line)
            if step and shows:
                print(
                    f"\r\033[K  {time.monotonic() - started:3.0f} s  {step.group().strip()}",
                    end="",
                    file=sys.stderr,
                )
    if shows:
        print("\r\033[K", end="", file=sys.stderr)
    if process.returncode:
        sys.exit(
            "launch.py: pip could not install the project; "
            "mend what it says above and run this again"
        )
    print(f"Set up in {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)


def main() -> None:
    """Set up, then replace this process by the command."""
    if sys.version_info < (3, 11):  # noqa: UP036  # the one file that an older Python may meet
        sys.exit(f"launch.py: Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    if sys.argv[1:2] in (["-h"], ["--help"]):
        print(__doc__)
        return
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    set_up(extras(sys.argv[1:]))
    command = BIN / sys.argv[1]
    if not command.exists():
        sys.exit(
            f"launch.py: no command {sys.argv[1]!r} in .venv; try: rosa, pytest, ruff, mypy, python"
        )
    environment = {
        **os.environ,
        "VIRTUAL_ENV": str(VENV),
        "PATH": f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}",
    }
    if os.name == "nt":
        sys.exit(subprocess.run([str(command), *sys.argv[2:]], env=environment).returncode)
    os.execve(command, [str(command), *sys.argv[2:]], environment)


if __name__ == "__main__":
    main()
