# Short names for the two commands of the README, and for the page of reports, the pictures of the docs, and the site.
.PHONY: page pictures run site test

page:
	cd missions/views/page && npm ci --ignore-scripts && npm run build

pictures:
	python3 launch.py python3 tests/missions/page_pictures.py

run:
	python3 launch.py rosa run suave_extended --plot mission.png

site:
	python3 launch.py sphinx-build -W --keep-going -b html -d build/doctrees docs build/site

test:
	python3 launch.py pytest
