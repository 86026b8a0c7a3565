"""`python -m missions` is the command line `rosa`."""

from missions.cli import main

main()
