# Short names for the two commands of the README.
.PHONY: run test

run:
	python3 launch.py rosa run suave_extended --plot mission.png

test:
	python3 launch.py pytest
