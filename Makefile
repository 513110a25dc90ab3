# Every target sets itself up: the first call makes .venv and installs edream with pinned packages, later calls use it at once.
PYTHON ?= python3
RUN := .venv/bin
export OMP_NUM_THREADS ?= 1

.PHONY: test check slow clean

test: .venv/ready
	$(RUN)/python -m pytest -m "not slow" -q

slow: .venv/ready
	$(RUN)/python -m pytest -m slow -q

check: .venv/ready-dev
	$(RUN)/ruff check edream tests
	$(RUN)/pyright
	$(RUN)/python -m pytest -q tests/test_house.py

.venv/ready: pyproject.toml constraints.txt
	test -x $(RUN)/python || $(PYTHON) -m venv .venv
	$(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	touch $@

.venv/ready-dev: .venv/ready
	$(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test,dev]"
	touch $@

clean:
	rm -rf .venv
