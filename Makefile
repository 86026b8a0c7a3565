# Short names for the two commands of the README, and for building the page that reports and live views show.
.PHONY: page pictures run test

page:
	cd missions/views/page && npm ci --ignore-scripts && npm run build

pictures:
	python3 launch.py python3 tests/missions/page_pictures.py

run:
	python3 launch.py rosa run suave_extended --plot mission.png

test:
	python3 launch.py pytest
