#!/usr/bin/env python3
"""Set up .venv beside this file when it is missing or out of date, then run a command in it.

    python3 launch.py rosa run suave_extended
    python3 launch.py pytest

Needs nothing but Python >= 3.11 and pip. The versions installed are those of constraints.txt.
"""

import hashlib
import os
import subprocess
import sys
import venv
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
MARK = VENV / "set-up-for"


def set_up() -> None:
    """Make the virtual environment and install this project in it; without the mark the next call does it anew."""
    try:
        inputs = b"".join((ROOT / name).read_bytes() for name in ("pyproject.toml", "constraints.txt", "launch.py"))
    except OSError as error:
        sys.exit(f"launch.py: cannot read {error.filename}: {error.strerror}; get it back from the repository")
    wanted = hashlib.sha256(inputs + sys.version.encode()).hexdigest()
    if MARK.is_file() and MARK.read_text() == wanted and (BIN / "python").exists():
        return
    if VENV.exists() and not VENV.is_dir():
        sys.exit(f"launch.py: {VENV} is in the way; it has to be a folder, so move it elsewhere and run this again")
    print("Setting up .venv (once, about half a minute) ...", file=sys.stderr, flush=True)
    python = str(BIN / "python")
    if find_spec("pip"):  # the outer pip serves, so a Python without ensurepip does too
        venv.create(VENV, clear=VENV.exists(), with_pip=False)
        pip = [sys.executable, "-m", "pip", "--python", python]
    elif find_spec("ensurepip"):
        venv.create(VENV, clear=VENV.exists(), with_pip=True)
        pip = [python, "-m", "pip"]
    else:
        sys.exit("launch.py: this Python has no pip; install it (Debian: apt-get install python3-pip)")
    constraints = str(ROOT / "constraints.txt")
    install = [*pip, "install", "--quiet", "--disable-pip-version-check", "-c", constraints, "-e", f"{ROOT}[dev]"]
    if subprocess.run(install, env={**os.environ, "PIP_CONSTRAINT": constraints}, stdout=sys.stderr).returncode:
        sys.exit("launch.py: pip could not install the project; mend what it says above and run this again")
    MARK.write_text(wanted)


def main() -> None:
    """Set up, then become the command that was asked for."""
    if sys.version_info < (3, 11):  # noqa: UP036  # the one file that an older Python may meet
        sys.exit(f"launch.py: Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    if sys.argv[1:2] in (["-h"], ["--help"]):
        print(__doc__)
        return
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    set_up()
    command = BIN / sys.argv[1]
    if not command.exists():
        sys.exit(f"launch.py: no command {sys.argv[1]!r} in .venv; try: rosa, pytest, ruff, mypy, python")
    environment = {**os.environ, "VIRTUAL_ENV": str(VENV), "PATH": f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}"}
    if os.name == "nt":
        sys.exit(subprocess.run([str(command), *sys.argv[2:]], env=environment).returncode)
    os.execve(command, [str(command), *sys.argv[2:]], environment)


if __name__ == "__main__":
    main()
